//! Arguments of `tesaki eval`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::examples;

const GRIP_COLUMNS: &str = "\
Columns of the table, in any order; contacts i = 1 to 6, at least 2 in each row:
  xi, yi, zi     position of the contact [m]
  nxi, nyi, nzi  normal into the object, of any length
  mui            coefficient of friction; default: --friction
  maxi           maximum normal force [N]; default: --max
  fx, fy, fz     total force of the contacts on the object [N]: to hold a weight, upwards
  mx, my, mz     total moment of the contacts on the object [N·m]; default: 0
  ox, oy, oz     reference point of the moment [m]; default: 0

Columns of the results:
  verdict        held, cannot-hold (proven), or open (borderline: neither forces nor a proof)
  fix, fiy, fiz  minimum-norm contact forces on the object [N]
  normali        normal force [N]
  usedi          used fraction of the friction limit, 0 to 1
  rest           relative residual of the load
  rank           rank of the grasp map: 5 if the contacts are collinear, else 6
  condition      condition number of the grasp map
  vx … wz        cannot-hold: a separating twist about the centroid of the contacts: the load has
                 more power on it than any admissible contact forces
  proof          cannot-hold: checked or failed, the twist verified in double precision";

const RNEA_COLUMNS: &str = "\
Columns of the table, in any order; all but the angles default to 0 unless stated otherwise:
  JOINT                 angle [rad]
  JOINT.velocity        [rad/s], for all joints or none
  JOINT.acceleration    [rad/s²], for all joints or none
  JOINT.rotor_inertia   reflected inertia of rotor and gear [kg·m²]
  TIP.fx, .fy, .fz      external force on the tip [N], in base axes
  TIP.mx, .my, .mz      external moment about the tip's origin [N·m], in base axes
  gx, gy, gz            gravity [m/s²] in base axes; default: 0, 0, -9.81

Columns of the results: TIP.tau.JOINT, the joint torque [N·m], without friction.
Includes the links of the chain to the tip and what is fixed to them, nothing behind other joints.";

const MASS_COLUMNS: &str = "\
Columns of the table, in any order:
  JOINT                 angle [rad]
  JOINT.rotor_inertia   reflected inertia of rotor and gear [kg·m²]; default: 0

Columns of the results: TIP.JOINT.JOINT, the elements of the mass matrix [kg·m²] row by row.
Includes the links of the chain to the tip and what is fixed to them, nothing behind other joints.";

const BIAS_COLUMNS: &str = "\
Columns of the table, in any order:
  JOINT                 angle [rad]
  JOINT.velocity        [rad/s]

Columns of the results, in base axes:
  TIP.ax, .ay, .az              acceleration of the tip's origin [m/s²] without joint acceleration
  TIP.alphax, .alphay, .alphaz  angular acceleration of the tip [rad/s²] without joint acceleration";

/// The quantities that `eval` computes.
#[derive(Subcommand)]
pub enum Eval {
    /// Forward kinematics: position and quaternion of each tip
    #[command(after_help = examples::KINEMATICS)]
    Fk(Kinematics),
    /// Geometric Jacobian of each tip, in base axes
    #[command(after_help = examples::KINEMATICS)]
    Jacobian(Kinematics),
    /// Inverse kinematics: joint angles for a position or a pose of each tip
    #[command(after_help = examples::KINEMATICS)]
    Ik(Kinematics),
    /// Inverse dynamics (recursive Newton-Euler): joint torques for a motion under gravity and an external
    /// wrench on the tip
    #[command(after_help = RNEA_COLUMNS)]
    Rnea(Kinematics),
    /// Mass matrix of the chain to each tip
    #[command(after_help = MASS_COLUMNS)]
    Mass(Kinematics),
    /// Bias acceleration of each tip: time derivative of the Jacobian times joint velocities
    #[command(after_help = BIAS_COLUMNS)]
    Bias(Kinematics),
    /// Least grip: the minimum-norm contact forces that hold a load, or a proof that none exist; needs no
    /// robot
    Grip(Grip),
}

#[derive(Args)]
pub struct Kinematics {
    /// Robot folder or URDF file
    #[arg(long, env = "TESAKI_ROBOT")]
    pub robot: PathBuf,
    /// Tip link, may be repeated; default: every moving leaf link (ik: those with columns in the table)
    #[arg(long, value_name = "LINK")]
    pub tip: Vec<String>,
    /// Link where the chains start and whose frame is used; default: the robot's base
    #[arg(long, value_name = "LINK")]
    pub base: Option<String>,
    /// CSV with a header: joint angles [rad] by name; for ik TIP.x, .y, .z [m] and .qx, .qy, .qz, .qw.
    /// The help of rnea, mass and bias lists further columns. - reads standard input
    #[arg(long = "in", value_name = "CSV")]
    pub input: PathBuf,
    /// CSV file for the results; - writes to standard output
    #[arg(long = "out", value_name = "CSV", default_value = "-")]
    pub output: PathBuf,
}

#[derive(Args)]
#[command(after_help = GRIP_COLUMNS)]
pub struct Grip {
    /// CSV with a header, contacts and a load in every row, see below; - reads standard input
    #[arg(long = "in", value_name = "CSV")]
    pub input: PathBuf,
    /// CSV file for the results; - writes to standard output
    #[arg(long = "out", value_name = "CSV", default_value = "-")]
    pub output: PathBuf,
    /// Fraction of the friction limit to keep in reserve, at least 0 and less than 1
    #[arg(long, value_name = "FRACTION", default_value = "0", allow_negative_numbers = true, value_parser = fraction)]
    pub margin: f32,
    /// Minimum normal force of every contact [N]
    #[arg(long, value_name = "N", default_value = "0", allow_negative_numbers = true, value_parser = not_negative)]
    pub min: f32,
    /// Coefficient of friction where the table gives none
    #[arg(long, value_name = "MU", allow_negative_numbers = true, value_parser = not_negative)]
    pub friction: Option<f32>,
    /// Maximum normal force where the table gives none [N]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = positive)]
    pub max: Option<f32>,
}

fn fraction(text: &str) -> Result<f32, String> {
    number(text, |value| (0.0..1.0).contains(&value), "of at least 0 and less than 1")
}

fn not_negative(text: &str) -> Result<f32, String> {
    number(text, |value| value >= 0.0, "of at least 0")
}

fn positive(text: &str) -> Result<f32, String> {
    number(text, |value| value > 0.0, "greater than 0")
}

fn number(text: &str, fits: impl Fn(f32) -> bool, allowed: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(value) if value.is_finite() && fits(value) => Ok(value),
        _ => Err(format!("{text:?}: expected a number {allowed}")),
    }
}
