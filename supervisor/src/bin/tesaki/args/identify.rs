//! Arguments of `tesaki identify`.

use std::path::PathBuf;

use clap::Args;

const HELP: &str = "\
Preparation: push the model, home, put the object at the position in the file, open the fingers
around it with room for the sweeps, and tare. Each joint is swept back and forth alone. Then the
object is grasped, lifted by 10 mm, shifted by 6 mm and turned by 0.06 rad back and forth, and put
down, once for each grip. This takes about 2 minutes. Ctrl-C disables the outputs: a held object
falls.

The force sensors are the reference: their gain errors appear in every torque constant. A joint
that moved or was loaded too little is listed with the reason and keeps its values.

With --joints the joints only sweep, in free motion: no object, no force sensor. A hand takes 8 to
20 s, an arm 25 s. Home first; nothing may be in the hand or in the way. A joint that needs more
torque than --torque, or a force on a tip, ends the test. Where a robot would fall without power
it holds afterwards until Ctrl-C. The friction is what a feed-forward needs: use it before the
first motion.

  tesaki identify robots/hand3/grasps/box.toml --out calibration.toml
  tesaki model push robots/hand3 --calibration calibration.toml
  tesaki identify --joints --out calibration.toml";

const USAGE: &str = "\
tesaki identify [OPTIONS] <FILE>
       tesaki identify [OPTIONS] --joints";

#[derive(Args)]
#[command(after_help = HELP, override_usage = USAGE)]
pub struct Identify {
    /// Grasp file, for example robots/hand3/grasps/box.toml
    #[arg(required_unless_present = "joints", conflicts_with = "joints")]
    pub file: Option<PathBuf>,
    /// Self-test after power-on: the friction of the joints of any robot, in free motion and without an
    /// object
    #[arg(long)]
    pub joints: bool,
    /// With --joints: the masses in the URDF were weighed, so the links' weight gives the torque constants
    #[arg(long, requires = "joints")]
    pub weighed: bool,
    /// With --joints: disable the outputs at once afterwards, even if the robot falls
    #[arg(long, requires = "joints")]
    pub no_hold: bool,
    /// With --joints: largest torque of a joint beyond the weight of its links, as a fraction of its limit;
    /// more ends the test
    #[arg(long, value_name = "FRACTION", default_value = "0.25", value_parser = fraction, allow_negative_numbers = true)]
    pub torque: f64,
    /// Calibration file to write, for `tesaki model push --calibration`
    #[arg(long, value_name = "FILE", default_value = "calibration.toml")]
    pub out: PathBuf,
    /// Amplitude of the sweep of each joint [rad]
    #[arg(long, default_value = "0.1", value_parser = amplitude, allow_negative_numbers = true)]
    pub amplitude: f64,
    /// Maximum normal force of each grip [N], at least two different values; a grip that fails is left out
    /// if two others succeed
    #[arg(
        long,
        value_name = "N,N",
        value_delimiter = ',',
        allow_hyphen_values = true,
        default_value = "2,6,4",
        conflicts_with = "joints"
    )]
    pub grips: Vec<f32>,
}

fn fraction(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.01..=1.0).contains(&value) => Ok(value),
        _ => Err(format!("{text:?}: expected a fraction of the torque limit from 0.01 to 1")),
    }
}

fn amplitude(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.03..=0.5).contains(&value) => Ok(value),
        _ => Err(format!("{text:?}: expected an amplitude from 0.03 to 0.5 rad")),
    }
}
