//! The signs of a city in the terminal.

use console::Style;
use sortie_envs::save_the_city::{BuildingState, Status};

use crate::views::Canvas;

/// The characters of a picture.
pub(super) struct Glyphs {
    pub(super) corners: [&'static str; 4],
    pub(super) edge: &'static str,
    pub(super) side: &'static str,
    pub(super) nothing: &'static str,
    pub(super) full: &'static str,
    pub(super) empty: &'static str,
    burning: &'static str,
    open: &'static str,
    complete: &'static str,
    burned_down: &'static str,
}

/// For terminals that show Unicode.
static UNICODE: Glyphs = Glyphs {
    corners: ["┌", "┐", "└", "┘"],
    edge: "─",
    side: "│",
    nothing: "·",
    full: "█",
    empty: "░",
    burning: "▲",
    open: "□",
    complete: "■",
    burned_down: "×",
};

/// For all others.
static ASCII: Glyphs = Glyphs {
    corners: ["+", "+", "+", "+"],
    edge: "-",
    side: "|",
    nothing: ".",
    full: "#",
    empty: ".",
    burning: "^",
    open: "o",
    complete: "=",
    burned_down: "x",
};

impl Glyphs {
    pub(super) fn of(canvas: Canvas) -> &'static Self {
        if canvas.is_unicode { &UNICODE } else { &ASCII }
    }
}

/// How a building looks on the map, the most urgent first.
#[derive(Clone, Copy)]
pub(super) enum Look {
    Burning,
    Open,
    Complete,
    BurnedDown,
}

impl Look {
    pub(super) fn of(building: &BuildingState) -> Self {
        match building.status {
            Status::Complete => Self::Complete,
            Status::BurnedDown => Self::BurnedDown,
            Status::Open if building.is_burning() => Self::Burning,
            Status::Open => Self::Open,
        }
    }

    pub(super) fn style(self) -> Style {
        match self {
            Self::Burning => Style::new().red().bold(),
            Self::Open => Style::new().yellow(),
            Self::Complete => Style::new().green(),
            Self::BurnedDown => Style::new().dim(),
        }
    }

    pub(super) fn word(self) -> &'static str {
        match self {
            Self::BurnedDown => "burned down",
            other => other.short_word(),
        }
    }

    /// At most eight characters.
    pub(super) fn short_word(self) -> &'static str {
        match self {
            Self::Burning => "burning",
            Self::Open => "open",
            Self::Complete => "complete",
            Self::BurnedDown => "burned",
        }
    }

    pub(super) fn symbol(self, glyphs: &Glyphs) -> String {
        let symbol = match self {
            Self::Burning => glyphs.burning,
            Self::Open => glyphs.open,
            Self::Complete => glyphs.complete,
            Self::BurnedDown => glyphs.burned_down,
        };
        self.style().apply_to(symbol).to_string()
    }
}
