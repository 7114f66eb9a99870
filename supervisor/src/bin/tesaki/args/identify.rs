//! `tesaki identify`.

use std::path::PathBuf;

use clap::Args;

const HELP: &str = "\
Before: push the model, home, put the object where the file says, open the fingers around it with room
for the sweeps, and tare. Each joint is swept to and fro by itself; then the object is grasped, lifted
by 10 mm, shifted by 6 mm and turned by 0.06 rad to and fro, and put down, once with each grip. It
takes some 2 minutes. Ctrl-C disarms, and what is held falls.

The force sensors are the reference: a gain error of theirs goes into every torque constant. A joint
that moved or was loaded too little is named with the reason, and keeps the values that it has.

  tesaki identify robots/hand3/grasps/box.toml --out calibration.toml
  tesaki model push robots/hand3 --calibration calibration.toml";

#[derive(Args)]
#[command(after_help = HELP)]
pub struct Identify {
    /// Where and how to grasp, such as robots/hand3/grasps/box.toml
    pub file: PathBuf,
    /// Where the values go, for `tesaki model push --calibration`
    #[arg(long, value_name = "FILE", default_value = "calibration.toml")]
    pub out: PathBuf,
    /// How far each joint is swept to either side [rad]
    #[arg(long, default_value = "0.1", value_parser = amplitude)]
    pub amplitude: f64,
    /// The grips: the largest of the normal forces of each [N], two or more different ones; one that
    /// the hand cannot make is left out if two others are enough
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_values_t = [2.0, 6.0, 4.0])]
    pub grips: Vec<f32>,
}

fn amplitude(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.03..=0.5).contains(&value) => Ok(value),
        _ => Err(format!("{text:?} is no amplitude from 0.03 to 0.5 rad")),
    }
}
