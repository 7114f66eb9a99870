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

  tesaki identify robots/hand3/grasps/box.toml --out calibration.toml
  tesaki model push robots/hand3 --calibration calibration.toml";

#[derive(Args)]
#[command(after_help = HELP)]
pub struct Identify {
    /// Grasp file, for example robots/hand3/grasps/box.toml
    pub file: PathBuf,
    /// Calibration file to write, for `tesaki model push --calibration`
    #[arg(long, value_name = "FILE", default_value = "calibration.toml")]
    pub out: PathBuf,
    /// Amplitude of the sweep of each joint [rad]
    #[arg(long, default_value = "0.1", value_parser = amplitude)]
    pub amplitude: f64,
    /// Maximum normal force of each grip [N], at least two different values; a grip that fails is left out
    /// if two others succeed
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_values_t = [2.0, 6.0, 4.0])]
    pub grips: Vec<f32>,
}

fn amplitude(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.03..=0.5).contains(&value) => Ok(value),
        _ => Err(format!("{text:?}: expected an amplitude from 0.03 to 0.5 rad")),
    }
}
