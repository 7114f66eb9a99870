//! Arguments of `tesaki calibrate`.

use std::path::PathBuf;

use clap::Args;

const HELP: &str = "\
A table of poses has one row a pose; the first one is the flat hand. Columns: back_qx, back_qy,
back_qz, back_qw for the orientation of the back of the hand; thumb1_qx … little3_qw for those
of the segments, 1 next to the palm; thumb_x, thumb_y, thumb_z … little_z for the markers in the
frame of the back of the hand [m]. Quaternions are absolute. Leave empty what was not measured.
A row whose column touch names a finger without marker is a posture in which the tip of the
thumb touches its tip.

With --live standard input has a JSON object a line, and the program says what to do:
  {\"time\": 0.01, \"back\": [x,y,z,w], \"thumb\": [[x,y,z,w],[x,y,z,w],[x,y,z,w]], …,
   \"markers\": {\"thumb\": [x,y,z], …}}

Examples:
  tesaki calibrate poses.csv --operator Aiko --out aiko.toml
  tesaki calibrate poses.csv --proportions      # markers on thumb, index and little finger only
  glove | tesaki calibrate --live --out aiko.toml";

#[derive(Args)]
#[command(after_help = HELP)]
pub struct Calibrate {
    /// Table of poses (CSV); `-` for standard input
    #[arg(required_unless_present = "live", conflicts_with = "live")]
    pub poses: Option<PathBuf>,
    /// Read a stream of samples from standard input and guide through the poses
    #[arg(long)]
    pub live: bool,
    /// Calibration file to write, replaced if it exists; default: operator.toml, which is not replaced
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Name of the operator
    #[arg(long, default_value = "operator")]
    pub operator: String,
    /// Infer fingers without marker from the proportions of the hand, and from touches with the thumb
    #[arg(long)]
    pub proportions: bool,
    /// Root mean square error of a sensor's orientation in a pose [°]; less than that of a sample if a pose is
    /// the mean over the time that it was held
    #[arg(long, value_name = "DEG", default_value = "0.5")]
    pub orientation_noise: f32,
    /// Standard deviation of a marker along each axis [mm]
    #[arg(long, value_name = "MM", default_value = "0.3")]
    pub marker_noise: f32,
}
