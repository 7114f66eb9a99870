//! Arguments of `model init`.

use std::path::PathBuf;

use clap::Args;
use tesaki_description::init::{MotorChoice, MotorPreset, PRESETS};

/// Example and list of motors.
pub fn help() -> String {
    let mut text = "\
Example:
  tesaki model init so101.urdf --motor sts3215 --motor gripper=xl330-m288 --out robots/so101
  tesaki model check robots/so101
  cargo sim serve --robot robots/so101

Motors (peak torque and speed at the joint):
"
    .to_owned();
    for motor in PRESETS {
        let MotorPreset { id, speed, source, .. } = motor;
        text += &format!("  {id:<12} {:>6.2} N·m {speed:>6.1} rad/s  ", motor.torque());
        let indent = 41;
        let mut column = indent;
        for word in source.split(' ') {
            let width = word.chars().count() + 1;
            if column + width > 100 {
                text += &format!("\n{:indent$}", "");
                column = indent;
            }
            text += &format!("{word} ");
            column += width;
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text + "  generic      sized by the URDF's effort and velocity; replace its values\n\n\
        Behind each value in the files stand its unit and its source: URDF, motor, computed or assumed."
}

#[derive(Args)]
pub struct Init {
    /// URDF file
    pub urdf: PathBuf,
    /// Folder to write; default: that of a file called robot.urdf, else a new one with the name of the robot
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Motor of all joints or, as JOINT=MOTOR, of one; default: the weakest with the torque of the URDF's
    /// effort limit, and at most three times that; where there is none, `generic`, of just that torque
    #[arg(long = "motor", value_name = "[JOINT=]MOTOR", value_parser = motor)]
    pub motors: Vec<MotorChoice>,
    /// Use the nearest inertia that a body can have for this link; `all` for all that need it
    #[arg(long, value_name = "LINK")]
    pub accept_inertia: Vec<String>,
    /// Overwrite controller.toml, plant.toml and, where the URDF is another file, robot.urdf
    #[arg(long)]
    pub force: bool,
}

fn motor(text: &str) -> Result<MotorChoice, String> {
    let (joint, motor) = match text.rsplit_once('=') {
        Some((joint, motor)) => (Some(joint.to_owned()), motor),
        None => (None, text),
    };
    if MotorPreset::names().contains(&motor) {
        Ok(MotorChoice { joint, motor: motor.to_owned() })
    } else {
        Err(format!("there is no motor {motor:?}; the motors are {}", MotorPreset::names().join(", ")))
    }
}
