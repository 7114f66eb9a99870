//! Arguments of `tesaki calibrate`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

const HELP: &str = "\
A table of postures has one row a posture; the first one is the flat hand. Columns: back_qx,
back_qy, back_qz, back_qw for the orientation of the back of the hand; thumb1_qx … little3_qw for
those of the segments, 1 next to the palm; thumb_x, thumb_y, thumb_z … little_z for the markers in
the frame of the back of the hand [m]. Quaternions are absolute. Leave empty what was not
measured. A row whose column touch names a finger without marker is a posture in which the tip of
the thumb touches its tip.

With --live standard input has a JSON object a line, and the program says what to do:
  {\"time\": 0.01, \"back\": [x,y,z,w], \"thumb\": [[x,y,z,w],[x,y,z,w],[x,y,z,w]], …,
   \"markers\": {\"thumb\": [x,y,z], …}}

Examples:
  tesaki calibrate postures.csv --name Aiko --out aiko.toml
  tesaki calibrate postures.csv --proportions      # markers on thumb, index and little finger only
  glove | tesaki calibrate --live --out aiko.toml";

const CAMERA_HELP: &str = "\
A table with one row a picture of a round plate that does not move, as the rose of a door knob.
Columns:
  x, y, z, qx, qy, qz, qw   pose of the hand [m] in a frame in which the plate does not move; or
  JOINT                     angles of the robot's joints [rad]; a joint without column is at 0
  u, v, radius              centre of the ellipse that the plate's rim is in the picture, and the
                            root of the product of its semi-axes [px]; or
  image                     picture (PNG or PGM, beside the table) in which the plate is found
  distance                  about how far the camera is from the plate [m]: helps to find it; with
                            --focal only

Some 30 pictures are good: nearer and farther, moved sideways, and turned about all axes.

Examples:
  tesaki calibrate camera --robot robots/knob-arm --in views.csv --rose 0.04 --out hand_eye.toml
  tesaki calibrate camera --robot robots/knob-arm --in circles.csv --rose 0.04 --size 256x240";

#[derive(Args)]
#[command(after_help = HELP, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Calibrate {
    #[command(subcommand)]
    pub command: Option<CalibrateCommand>,
    /// Table of postures (CSV); `-` for standard input
    #[arg(required_unless_present = "live", conflicts_with = "live")]
    pub postures: Option<PathBuf>,
    /// Read a stream of samples from standard input and guide through the postures
    #[arg(long)]
    pub live: bool,
    /// Calibration file to write, replaced if it exists; default: operator.toml, which is not replaced
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Name of the operator
    #[arg(long, default_value = "operator")]
    pub name: String,
    /// Infer fingers without marker from the proportions of the hand, and from touches with the thumb
    #[arg(long)]
    pub proportions: bool,
    /// Root mean square error of a sensor's orientation in a posture [°]; less than that of a sample if a
    /// posture is the mean over the time that it was held
    #[arg(long, value_name = "DEG", default_value = "0.5", value_parser = orientation_noise, allow_negative_numbers = true)]
    pub orientation_noise: f32,
    /// Standard deviation of a marker along each axis [mm]
    #[arg(long, value_name = "MM", default_value = "0.3", value_parser = marker_noise, allow_negative_numbers = true)]
    pub marker_noise: f32,
}

#[derive(Subcommand)]
pub enum CalibrateCommand {
    /// Calibrate the camera in a robot's hand from pictures of a round plate, such as the rose of a door
    /// knob; needs no board
    #[command(after_help = CAMERA_HELP)]
    Camera(CalibrateCamera),
}

#[derive(Args)]
pub struct CalibrateCamera {
    /// Robot folder
    #[arg(long, env = "TESAKI_ROBOT", value_name = "DIR")]
    pub robot: PathBuf,
    /// Table of poses and circles or pictures (CSV), see below; `-` for standard input
    #[arg(long = "in", value_name = "CSV")]
    pub input: PathBuf,
    /// Radius of the plate's front rim [m]
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub rose: f64,
    /// Size of the pictures [px]; needed for a table without pictures
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub size: Option<[u32; 2]>,
    /// Where the optical axis meets the picture [px]; default: its middle
    #[arg(long, value_name = "U,V", value_parser = principal, allow_hyphen_values = true)]
    pub principal: Option<[f64; 2]>,
    /// Approximate focal length [px]; default: half to one and a half times the width
    #[arg(long, value_name = "PX", allow_negative_numbers = true)]
    pub focal: Option<f64>,
    /// Distances of the table, from the origin of the hand frame along the approach [m]
    #[arg(long, value_name = "NEAR..FAR", default_value = "0.02..0.3", value_parser = distances, allow_hyphen_values = true)]
    pub distances: [f64; 2],
    /// File to write, replaced if it exists; default: hand_eye.toml in the robot folder, which is not
    /// replaced
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Two numbers with `separator` between them.
fn pair<T: std::str::FromStr>(text: &str, separator: &str) -> Option<[T; 2]> {
    let (first, second) = text.split_once(separator)?;
    Some([first.trim().parse().ok()?, second.trim().parse().ok()?])
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let found = pair(text, "x").filter(|size| size.iter().all(|side| (32..=16384).contains(side)));
    found.ok_or_else(|| {
        format!("{text:?}: expected WIDTHxHEIGHT, each 32 to 16384 pixels, for example 256x240")
    })
}

fn principal(text: &str) -> Result<[f64; 2], String> {
    pair(text, ",").ok_or_else(|| format!("{text:?}: expected U,V in pixels, for example 127.5,119.5"))
}

fn distances(text: &str) -> Result<[f64; 2], String> {
    pair(text, "..").ok_or_else(|| format!("{text:?}: expected NEAR..FAR in metres, for example 0.02..0.3"))
}

/// A standard deviation from `least` to `most` of a unit.
fn noise(text: &str, [least, most]: [f32; 2], unit: &str) -> Result<f32, String> {
    let noise = text.parse().ok().filter(|noise| (least..=most).contains(noise));
    noise.ok_or_else(|| format!("{text:?}: expected {least} to {most} {unit}"))
}

fn orientation_noise(text: &str) -> Result<f32, String> {
    noise(text, [0.0, 11.0], "°")
}

fn marker_noise(text: &str) -> Result<f32, String> {
    noise(text, [0.001, 10.0], "mm")
}
