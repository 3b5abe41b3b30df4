//! Configurations by definitions of their keys: each is written once, and is a field of a type and a key of files.

use super::key::Section;

/// Defines the configuration of a method: the type of the whole, one of each section with its defaults, and the keys.
///
/// A key is its sentence, name, type, default, range, and unit if its value is a number of something. The sentence is
/// the field's documentation and what is said of the key in files. A section that is defined elsewhere, because several
/// have it, is its type, default and keys; those within a section follow its own keys, behind `within:`. A key that stands
/// above all sections is `above`, with what it is about, and a field that no file has is `besides`.
///
/// Files may lack keys, which are defaults then, where `#[serde(default)]` stands before the name of the whole; or that
/// of one key or section.
///
/// ```
/// # use sortie_learn::configuration::{OPTIMISER, OptimiserConfig, Range};
/// sortie_learn::sections! {
///     /// What a run leaves open.
///     Config, KEYS;
///
///     /// What is kept.
///     replay: ReplayConfig {
///         /// Decisions that are kept.
///         capacity: usize = 100, Range::Whole(1, 1000), "decisions";
///
///         within:
///         /// How what is kept is learned from.
///         optimiser: OptimiserConfig = OptimiserConfig::default(), OPTIMISER;
///     }
/// }
/// assert_eq!(Config::default().replay.capacity, 100);
/// assert_eq!((KEYS[0].about, KEYS[0].keys[0].unit), ("What is kept.", "decisions"));
/// assert_eq!(KEYS[1].name, "replay.optimiser");
/// ```
#[macro_export]
macro_rules! sections {
    ($(#[doc = $whole:literal])+ #[serde(default)] $($rest:tt)+) => {
        $crate::sections! { @with (default, deny_unknown_fields) $(#[doc = $whole])+ $($rest)+ }
    };
    ($(#[doc = $whole:literal])+ $config:ident, $($rest:tt)+) => {
        $crate::sections! { @with (deny_unknown_fields) $(#[doc = $whole])+ $config, $($rest)+ }
    };
    (
        @with $rules:tt
        $(#[doc = $whole:literal])+
        $config:ident, $keys:ident;
        $(above $top_about:literal {
            $(#[doc = $top_sentence:literal])+
            $top:ident: $top_type:ty = $top_default:expr, $top_range:expr;
        })?
        $(besides { $(#[doc = $open_about:literal])+ $open:ident: $open_type:ty })?
        $(
            $(#[doc = $about:literal])+
            $(#[serde($($lacking:tt)+)])?
            $section:ident: $type:ident
            $({ $($body:tt)+ })?
            $(= $default:expr, $other:expr;)?
        )+
    ) => {
        $(#[doc = $whole])+
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde $rules]
        pub struct $config {
            $($(#[doc = $top_sentence])+ pub $top: $top_type,)?
            $($(#[doc = $open_about])+ #[serde(skip)] pub $open: $open_type,)?
            $($(#[doc = $about])+ $(#[serde($($lacking)+)])? pub $section: $type,)+
        }

        impl Default for $config {
            fn default() -> Self {
                Self {
                    $($top: $top_default,)?
                    $($open: <$open_type>::default(),)?
                    $($section: $crate::sections!(@default $type $(, $default)?),)+
                }
            }
        }

        $($crate::sections! { @type $rules, $type, $($about)+; $($($body)+)? })+

        /// The keys by sections.
        pub(crate) const $keys: &[$crate::configuration::Section] = {
            const PARTS: &[&[$crate::configuration::Section]] = &[
                $(&[$crate::configuration::Section {
                    name: "",
                    about: $top_about,
                    keys: &[$crate::sections!(@key $top, $top_range, $($top_sentence)+)],
                }],)?
                $($crate::sections!(
                    @sections $section, concat!($($about),+).trim_ascii();
                    $($($body)+)? $(= $other)?
                ),)+
            ];
            &$crate::configuration::joined::<{ $crate::configuration::count(PARTS) }>(PARTS)
        };
    };
    (@default $type:ident) => { $type::default() };
    (@default $type:ident, $default:expr) => { $default };
    (@type $rules:tt, $type:ident, $($about:literal)+;) => {};
    (
        @type $rules:tt, $type:ident, $($about:literal)+;
        $(
            $(#[doc = $sentence:literal])+
            $(#[serde($($lacking:tt)+)])?
            $key:ident: $value:ty = $default:expr, $range:expr $(, $unit:literal)?;
        )*
        $(within: $(
            $(#[doc = $inner_about:literal])+
            $inner:ident: $inner_type:ty = $inner_default:expr, $inner_keys:expr;
        )+)?
    ) => {
        $(#[doc = $about])+
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde $rules]
        pub struct $type {
            $($(#[doc = $sentence])+ $(#[serde($($lacking)+)])? pub $key: $value,)*
            $($($(#[doc = $inner_about])+ pub $inner: $inner_type,)+)?
        }

        impl Default for $type {
            fn default() -> Self {
                Self { $($key: $default,)* $($($inner: $inner_default,)+)? }
            }
        }
    };
    (@sections $section:ident, $about:expr; = $keys:expr) => {
        &[$crate::configuration::Section {
            name: stringify!($section),
            about: $about,
            keys: $keys,
        }]
    };
    (
        @sections $section:ident, $about:expr;
        $($(
            $(#[doc = $sentence:literal])+
            $(#[serde($($lacking:tt)+)])?
            $key:ident: $value:ty = $default:expr, $range:expr $(, $unit:literal)?;
        )+)?
        $(within: $(
            $(#[doc = $inner_about:literal])+
            $inner:ident: $inner_type:ty = $inner_default:expr, $inner_keys:expr;
        )+)?
    ) => {
        &[
            $($crate::configuration::Section {
                name: stringify!($section),
                about: $about,
                keys: &[$($crate::sections!(@key $key, $range, $($sentence)+ $(, $unit)?)),+],
            },)?
            $($($crate::configuration::Section {
                name: concat!(stringify!($section), ".", stringify!($inner)),
                about: concat!($($inner_about),+).trim_ascii(),
                keys: $inner_keys,
            },)+)?
        ]
    };
    (@key $key:ident, $range:expr, $($sentence:literal)+ $(, $unit:literal)?) => {
        $crate::configuration::Key::new(
            stringify!($key),
            concat!("" $(, $unit)?),
            $range,
            concat!($($sentence),+).trim_ascii(),
        )
    };
}

/// Defines a section that several have: its type with its defaults, and its keys, as in [`sections!`].
///
/// ```
/// # use sortie_learn::configuration::Range;
/// sortie_learn::section! {
///     /// What is kept.
///     ReplayConfig, REPLAY;
///
///     /// Decisions that are kept.
///     capacity: usize = 100, Range::Whole(1, 1000), "decisions";
/// }
/// assert_eq!((ReplayConfig::default().capacity, REPLAY[0].name), (100, "capacity"));
/// ```
#[macro_export]
macro_rules! section {
    ($(#[doc = $about:literal])+ #[serde(default)] $($rest:tt)+) => {
        $crate::section! { @with (default, deny_unknown_fields) $(#[doc = $about])+ $($rest)+ }
    };
    (
        @with $rules:tt
        $(#[doc = $about:literal])+
        $type:ident, $visibility:vis $keys:ident;
        $(
            $(#[doc = $sentence:literal])+
            $key:ident: $value:ty = $default:expr, $range:expr $(, $unit:literal)?;
        )+
    ) => {
        $crate::sections! {
            @type $rules, $type, $($about)+;
            $($(#[doc = $sentence])+ $key: $value = $default, $range;)+
        }

        #[doc = concat!("The keys of [`", stringify!($type), "`].")]
        $visibility const $keys: &[$crate::configuration::Key] = &[$(
            $crate::sections!(@key $key, $range, $($sentence)+ $(, $unit)?),
        )+];
    };
    ($(#[doc = $about:literal])+ $type:ident, $($rest:tt)+) => {
        $crate::section! { @with (deny_unknown_fields) $(#[doc = $about])+ $type, $($rest)+ }
    };
}

/// How many sections there are in these parts.
#[doc(hidden)]
pub const fn count(parts: &[&[Section]]) -> usize {
    let (mut sections, mut part) = (0, 0);
    while part < parts.len() {
        sections += parts[part].len();
        part += 1;
    }
    sections
}

/// The sections of these parts one after the other.
#[doc(hidden)]
pub const fn joined<const COUNT: usize>(parts: &[&[Section]]) -> [Section; COUNT] {
    let mut sections = [Section { name: "", about: "", keys: &[] }; COUNT];
    let (mut at, mut part) = (0, 0);
    while part < parts.len() {
        let mut place = 0;
        while place < parts[part].len() {
            sections[at] = parts[part][place];
            (at, place) = (at + 1, place + 1);
        }
        part += 1;
    }
    sections
}

/// Defines the words that a key may have: a type with a variant for each, and `WORDS`.
///
/// ```
/// sortie_learn::words! {
///     /// Who goes first.
///     First {
///         /// Whoever came last.
///         Last = "last",
///         /// Nobody.
///         Nobody = "nobody",
///     }
/// }
/// assert_eq!(First::WORDS, ["last", "nobody"]);
/// ```
#[macro_export]
macro_rules! words {
    (
        $(#[$about:meta])+
        $type:ident {
            $($(#[$sentence:meta])+ $variant:ident = $word:literal,)+
        }
    ) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        $(#[$about])+
        pub enum $type {
            $($(#[$sentence])+ #[serde(rename = $word)] $variant,)+
        }

        impl $type {
            /// All words.
            pub const WORDS: &[&str] = &[$($word),+];
        }
    };
}
