//! A comparison as pictures, which are SVG text.
//!
//! Every label keeps its colour and its dash in all pictures. The colours can be told apart by people
//! with any colour vision (Okabe and Ito); where they repeat, the dash differs.

mod bars;
mod curves;

use std::io;

use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

pub use bars::{Bar, Bars, draw_bars, ends, teams};
pub use curves::{Line, curves, growth};

use crate::error::{LearnError, Result};

/// Pixels of a picture; browsers and documents scale it.
const WIDTH: u32 = 1200;
/// Pixels between the border and what is drawn.
const MARGIN: i32 = 28;
/// Height of the strip with the title.
const TITLE_HEIGHT: i32 = 76;

/// Of labels.
const LABEL_SIZE: i32 = 20;

const INK: RGBColor = RGBColor(0x22, 0x22, 0x22);
const FAINT_INK: RGBColor = RGBColor(0x60, 0x60, 0x60);
const GRID: RGBColor = RGBColor(0xe2, 0xe2, 0xe2);

const COLOURS: [RGBColor; 7] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0x66, 0x66, 0x66),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0xe6, 0x9f, 0x00),
];

/// Pixels drawn and left out; the first is a full line.
const DASHES: [Option<(u32, u32)>; 4] = [None, Some((18, 8)), Some((6, 6)), Some((34, 10))];

pub(crate) type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(crate) type Drawn = Result<(), DrawingAreaErrorKind<io::Error>>;

fn colour(index: usize) -> RGBColor {
    COLOURS[index % COLOURS.len()]
}

fn dash(index: usize) -> Option<(u32, u32)> {
    DASHES[index % DASHES.len()]
}

/// Draws on a white canvas with a title.
fn picture(height: u32, title: &str, draw: impl FnOnce(&Canvas<'_>) -> Drawn) -> Result<String> {
    let picture = svg((WIDTH, height), |canvas| {
        let size = fitting(title, 28, WIDTH as i32 - 2 * MARGIN);
        text(canvas, title, (MARGIN, TITLE_HEIGHT / 2), size, INK, HPos::Left)?;
        draw(canvas)
    });
    picture.map_err(|error| LearnError::format(format!("picture `{title}`"), error))
}

/// Draws on a white canvas of a size; why that failed.
pub(crate) fn svg(
    size: (u32, u32),
    draw: impl FnOnce(&Canvas<'_>) -> Drawn,
) -> Result<String, String> {
    let mut svg = String::new();
    let canvas = SVGBackend::with_string(&mut svg, size).into_drawing_area();
    let drawn = canvas.fill(&WHITE).and_then(|()| draw(&canvas)).and_then(|()| canvas.present());
    drop(canvas);
    drawn.map_err(|error| error.to_string()).map(|()| svg)
}

/// One line of text, vertically centred at a place.
fn text(
    canvas: &Canvas<'_>,
    line: &str,
    place: (i32, i32),
    size: i32,
    colour: RGBColor,
    side: HPos,
) -> Drawn {
    let style = TextStyle::from(("sans-serif", size).into_font())
        .color(&colour)
        .pos(Pos::new(side, VPos::Center));
    canvas.draw(&Text::new(line, place, style))
}

/// Pixels that a text takes at most, since the font is the reader's.
fn text_width(line: &str, size: i32) -> i32 {
    (line.chars().count() as f64 * f64::from(size) * 0.6).ceil() as i32
}

/// The size, or the largest one below it at which a text fits into so many pixels.
fn fitting(line: &str, size: i32, room: i32) -> i32 {
    (1..=size).rev().find(|size| text_width(line, *size) <= room).unwrap_or(1)
}

/// Line of a label: whole or dashed.
fn stroke(canvas: &Canvas<'_>, points: Vec<(i32, i32)>, index: usize) -> Drawn {
    let style = colour(index).stroke_width(4);
    match dash(index) {
        None => canvas.draw(&PathElement::new(points, style)),
        Some((drawn, left_out)) => {
            canvas.draw(&DashedPathElement::new(points, drawn, left_out, style))
        }
    }
}
