//! `tesaki impedance …`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

#[derive(Subcommand)]
pub enum Impedance {
    /// Hold the tool where it is and yield when something pushes it, until Ctrl-C; then disarm
    Hold(Hold),
    /// Say where the tool is and what pushes it, whoever commands
    Status,
}

#[derive(Args)]
pub struct Hold {
    /// How the arm is to yield, such as robots/arm7/impedances/soft.toml
    pub file: PathBuf,
    /// Disarm after so long [s]; without it, hold until Ctrl-C
    #[arg(long, value_parser = super::seconds)]
    pub duration: Option<Duration>,
}
