//! What `eval` can be told.

use std::path::PathBuf;

use clap::{Args, Subcommand};

const GRIP_COLUMNS: &str = "\
Columns of the table, in any order; contacts i = 1 to 6, of which each row fills in 2 or more:
  xi, yi, zi     place [m]
  nxi, nyi, nzi  normal into the object, of any length
  mui            coefficient of friction; where there is none, --friction
  maxi           largest normal force [N]; where there is none, --max
  fx, fy, fz     force that the contacts shall exert on the object [N]: to hold a weight, upwards
  mx, my, mz     moment likewise [N·m]; without these columns 0
  ox, oy, oz     the point about which the moment is [m]; without these columns 0

Results, a row each:
  verdict        held, cannot-hold (proven), or open (neither forces nor proof: near the edge)
  fix, fiy, fiz  least forces on the object [N]
  normali        normal force [N]
  usedi          share of the friction that is used, 0 to 1
  rest           what is missing to the load, as a share of it
  rank           of the grasp map: 5 if the contacts are in one line, else 6
  condition      of the grasp map
  vx … wz        cannot-hold: a twist about the contacts' centroid, against which the load has more
                 power than any forces of the contacts
  proof          cannot-hold: whether that is so in double precision, too: checked or failed";

const RNEA_COLUMNS: &str = "\
Columns of the table, in any order; the angles are needed, the rest counts as 0 unless stated:
  JOINT                 angle [rad]
  JOINT.velocity        [rad/s], for each joint or for none
  JOINT.acceleration    [rad/s²], for each joint or for none
  JOINT.rotor_inertia   reflected inertia of rotor and gear [kg·m²]
  TIP.fx, .fy, .fz      force of the world on the tip [N], in axes of the base
  TIP.mx, .my, .mz      its moment about the tip's origin [N·m], in axes of the base
  gx, gy, gz            gravity [m/s²] in axes of the base; without these columns 0, 0, -9.81

Results, a row each: TIP.tau.JOINT, the torque that the joint must give [N·m]; friction is not in it.
The tip carries what is fixed to the links on the way to it, and nothing behind other joints.";

const MASS_COLUMNS: &str = "\
Columns of the table, in any order:
  JOINT                 angle [rad]
  JOINT.rotor_inertia   reflected inertia of rotor and gear [kg·m²]; without this column 0

Results, a row each: TIP.JOINT.JOINT, the elements of the mass matrix [kg·m²] row by row.
The tip carries what is fixed to the links on the way to it, and nothing behind other joints.";

const BIAS_COLUMNS: &str = "\
Columns of the table, in any order:
  JOINT                 angle [rad]
  JOINT.velocity        [rad/s]

Results, a row each, in axes of the base:
  TIP.ax, .ay, .az              acceleration of the tip's origin [m/s²] without joint acceleration
  TIP.alphax, .alphay, .alphaz  angular acceleration likewise [rad/s²]";

/// What `eval` computes.
#[derive(Subcommand)]
pub enum Eval {
    /// Forward kinematics: position and quaternion of each tip
    Fk(Kinematics),
    /// Geometric Jacobian of each tip, in axes of the base
    Jacobian(Kinematics),
    /// Inverse kinematics: joint angles that bring each tip to a position or a pose
    Ik(Kinematics),
    /// Inverse dynamics (recursive Newton-Euler): torques for a motion, under gravity and a wrench on the tip
    #[command(after_help = RNEA_COLUMNS)]
    Rnea(Kinematics),
    /// Mass matrix of the joints on the way to each tip
    #[command(after_help = MASS_COLUMNS)]
    Mass(Kinematics),
    /// Bias acceleration of each tip: change of the Jacobian times joint velocities
    #[command(after_help = BIAS_COLUMNS)]
    Bias(Kinematics),
    /// Least grip: the smallest contact forces that hold a load, or the proof that none do; needs no robot
    Grip(Grip),
}

#[derive(Args)]
pub struct Kinematics {
    /// The robot's folder, or a URDF alone
    #[arg(long, env = "TESAKI_ROBOT")]
    pub robot: PathBuf,
    /// A link to compute, again for more; without it every leaf link that moves (ik: those with columns)
    #[arg(long, value_name = "LINK")]
    pub tip: Vec<String>,
    /// The link where the chains start and whose frame is used; without it the robot's base
    #[arg(long, value_name = "LINK")]
    pub base: Option<String>,
    /// CSV with a header: joint angles [rad] by name; for ik TIP.x, .y, .z [m] and .qx, .qy, .qz, .qw; more
    /// below for some; - reads stdin
    #[arg(long = "in", value_name = "CSV")]
    pub input: PathBuf,
    /// Where the results go; - writes to stdout
    #[arg(long = "out", value_name = "CSV", default_value = "-")]
    pub output: PathBuf,
}

#[derive(Args)]
#[command(after_help = GRIP_COLUMNS)]
pub struct Grip {
    /// CSV with a header: contacts and a load in every row, see below; - reads stdin
    #[arg(long = "in", value_name = "CSV")]
    pub input: PathBuf,
    /// Where the results go; - writes to stdout
    #[arg(long = "out", value_name = "CSV", default_value = "-")]
    pub output: PathBuf,
    /// Share of the friction that is left unused, from 0 to below 1
    #[arg(long, value_name = "SHARE", default_value = "0", allow_negative_numbers = true, value_parser = share)]
    pub margin: f32,
    /// Least normal force of every contact [N]
    #[arg(long, value_name = "N", default_value = "0", allow_negative_numbers = true, value_parser = not_negative)]
    pub least: f32,
    /// Coefficient of friction where the table has none
    #[arg(long, value_name = "MU", allow_negative_numbers = true, value_parser = not_negative)]
    pub friction: Option<f32>,
    /// Largest normal force where the table has none [N]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = positive)]
    pub max: Option<f32>,
}

fn share(text: &str) -> Result<f32, String> {
    number(text, |value| (0.0..1.0).contains(&value), "at least 0 and less than 1")
}

fn not_negative(text: &str) -> Result<f32, String> {
    number(text, |value| value >= 0.0, "at least 0")
}

fn positive(text: &str) -> Result<f32, String> {
    number(text, |value| value > 0.0, "more than 0")
}

fn number(text: &str, fits: impl Fn(f32) -> bool, allowed: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if value.is_finite() && fits(value) => Ok(value),
        _ => Err(format!("{text:?} is no number that is {allowed}")),
    }
}
