//! Arguments of `tesaki find-circle`.

use std::path::PathBuf;

use clap::Args;

const HELP: &str = "\
The likeliest circle is found: of a door knob the rose, if --radius leaves no other circle. The
centre of the pixel in the corner is at (0, 0), x to the right, y down. The radius is the root of
the product of the semi-axes of the ellipse that the circle is in the picture.

Examples:
  tesaki find-circle coin.png
  tesaki find-circle --radius 20..60 --annotate found.png knob.png
  tesaki find-circle --radius 15..25 --window 69,94,10 knob1.pgm knob2.pgm
  tesaki find-circle --axis 127,95,7 knob.png
  tesaki --json find-circle knob.png";

#[derive(Args)]
#[command(after_help = HELP)]
pub struct FindCircle {
    /// Pictures: PNG or PGM, grey or colour
    #[arg(required = true, value_name = "IMAGE")]
    pub images: Vec<PathBuf>,
    /// Expected radius from … to [px]; without it, 10 px to half of the shorter side, at most 400 px; in a
    /// picture with a side of more than 1000, 2000, … px, two, three, … times as much
    #[arg(long, value_name = "MIN..MAX", value_parser = radius, allow_hyphen_values = true)]
    pub radius: Option<[f32; 2]>,
    /// Look for the centre only within REACH of (X, Y) [px]
    #[arg(long, value_name = "X,Y,REACH", value_parser = window, allow_hyphen_values = true)]
    pub window: Option<[f32; 3]>,
    /// Vanishing point (X, Y) of the knob's axis, known to REACH [px]; finds a rose that the knob partly
    /// hides
    #[arg(long, value_name = "X,Y,REACH", value_parser = window, allow_hyphen_values = true)]
    pub axis: Option<[f32; 3]>,
    /// Write the picture with the circle and its centre drawn in red; for one picture only
    #[arg(long, value_name = "PNG")]
    pub annotate: Option<PathBuf>,
}

pub fn radius(text: &str) -> Result<[f32; 2], String> {
    let numbers =
        text.split_once("..").map(|(from, to)| [from, to].map(|number| number.trim().parse::<f32>()));
    match numbers {
        Some([Ok(from), Ok(_)]) if from <= 0.0 => {
            Err(format!("{text:?}: MIN, {from} px, is not above 0: for example 20..60"))
        }
        Some([Ok(from), Ok(to)]) if from.is_finite() && to.is_finite() && from < to => Ok([from, to]),
        Some([Ok(from), Ok(to)]) if from >= to => {
            Err(format!("{text:?}: MIN, {from} px, is not below MAX, {to} px: for example 20..60"))
        }
        _ => Err(format!("{text:?}: expected MIN..MAX in pixels, for example 20..60")),
    }
}

pub fn window(text: &str) -> Result<[f32; 3], String> {
    let numbers: Result<Vec<f32>, _> = text.split(',').map(|number| number.trim().parse::<f32>()).collect();
    match numbers.ok().and_then(|numbers| <[f32; 3]>::try_from(numbers).ok()) {
        Some(numbers) if numbers.iter().all(|number| number.is_finite()) => Ok(numbers),
        _ => Err(format!("{text:?}: expected X,Y,REACH in pixels, for example 69,94,10")),
    }
}
