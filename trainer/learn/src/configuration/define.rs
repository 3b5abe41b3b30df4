//! Configurations by definitions of their keys: each is written once, and is a field of a type and a key of files.

/// Defines the configuration of a method: the type of the whole, one of each section with its defaults, and the keys.
///
/// A key is its sentence, name, type, default, range, and unit if its value is a number of something. The sentence is
/// the field's documentation and what is said of the key in files. Sections that several methods have come last, behind
/// `also:`, as their type and its keys.
///
/// ```
/// # use sortie_learn::configuration::Range;
/// sortie_learn::sections! {
///     /// What a run leaves open.
///     Config, KEYS;
///
///     /// What is kept.
///     replay: ReplayConfig {
///         /// Decisions that are kept.
///         capacity: usize = 100, Range::Whole(1, 1000), "decisions";
///     }
/// }
/// assert_eq!(Config::default().replay.capacity, 100);
/// assert_eq!((KEYS[0].about, KEYS[0].keys[0].unit), ("What is kept.", "decisions"));
/// ```
#[macro_export]
macro_rules! sections {
    (
        $(#[doc = $whole:literal])+
        $config:ident, $keys:ident;
        $(
            $(#[doc = $about:literal])+
            $section:ident: $type:ident {
                $(
                    $(#[doc = $sentence:literal])+
                    $key:ident: $value:ty = $default:expr, $range:expr $(, $unit:literal)?;
                )+
            }
        )+
        $(also: $(
            $(#[doc = $other_about:literal])+
            $other:ident: $other_type:ty = $other_keys:expr;
        )+)?
    ) => {
        $(#[doc = $whole])+
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $config {
            $($(#[doc = $about])+ pub $section: $type,)+
            $($($(#[doc = $other_about])+ pub $other: $other_type,)+)?
        }

        $(
            $(#[doc = $about])+
            #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
            #[serde(deny_unknown_fields)]
            pub struct $type {
                $($(#[doc = $sentence])+ pub $key: $value,)+
            }

            impl Default for $type {
                fn default() -> Self {
                    Self { $($key: $default,)+ }
                }
            }
        )+

        /// The keys by sections.
        pub const $keys: &[$crate::configuration::Section] = &[$(
            $crate::configuration::Section {
                name: stringify!($section),
                about: concat!($($about),+).trim_ascii(),
                keys: &[$(
                    $crate::configuration::Key::new(
                        stringify!($key),
                        concat!("" $(, $unit)?),
                        $range,
                        concat!($($sentence),+).trim_ascii(),
                    ),
                )+],
            },
        )+ $($(
            $crate::configuration::Section {
                name: stringify!($other),
                about: concat!($($other_about),+).trim_ascii(),
                keys: $other_keys,
            },
        )+)?];
    };
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
        $(#[doc = $about:literal])+
        $type:ident {
            $($(#[doc = $sentence:literal])+ $variant:ident = $word:literal,)+
        }
    ) => {
        $(#[doc = $about])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        pub enum $type {
            $($(#[doc = $sentence])+ #[serde(rename = $word)] $variant,)+
        }

        impl $type {
            /// All words.
            pub const WORDS: &[&str] = &[$($word),+];
        }
    };
}
