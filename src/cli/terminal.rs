//! What a terminal can show.

use std::env;

use clap::ValueEnum;
use console::Term;

/// When output has colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum Color {
    /// On a terminal, unless NO_COLOR is set or TERM is `dumb`
    #[default]
    Auto,
    /// In pipes and files too
    Always,
    /// Nowhere
    Never,
}

impl Color {
    /// Has everything that this program draws follow.
    pub(crate) fn apply(self) {
        match self {
            Self::Auto => {}
            Self::Always | Self::Never => {
                console::set_colors_enabled(self == Self::Always);
                console::set_colors_enabled_stderr(self == Self::Always);
            }
        }
    }
}

/// Whether pictures and bars may change in place there: no paper, no pipe, no terminal that only writes lines.
pub(crate) fn redraws(terminal: &Term) -> bool {
    terminal.is_term() && env::var_os("TERM").is_some_and(|name| name != "dumb")
}

/// Whether the locale's characters are Unicode.
pub(crate) fn is_unicode() -> bool {
    let set = |name| env::var(name).ok().filter(|value| !value.is_empty());
    is_unicode_locale(["LC_ALL", "LC_CTYPE", "LANG"].into_iter().find_map(set).as_deref())
}

/// Containers seldom set a locale, and nearly every terminal shows Unicode: it takes a locale that says otherwise.
fn is_unicode_locale(locale: Option<&str>) -> bool {
    locale.is_none_or(|locale| {
        let locale = locale.to_ascii_lowercase();
        locale.contains("utf-8") || locale.contains("utf8")
    })
}

/// Characters of a line in tables and lists for people: those of the terminal, at most what is easily read.
pub(crate) fn line_width() -> usize {
    const READABLE: usize = 100;
    usize::from(Term::stdout().size().1).clamp(40, READABLE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_locale_that_says_so_is_not_unicode() {
        for unicode in [None, Some("C.UTF-8"), Some("de_DE.utf8"), Some("en_US.UTF-8")] {
            assert!(is_unicode_locale(unicode), "{unicode:?}");
        }
        for other in ["C", "POSIX", "de_DE.ISO-8859-1"] {
            assert!(!is_unicode_locale(Some(other)), "{other}");
        }
    }
}
