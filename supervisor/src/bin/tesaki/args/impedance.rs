//! Arguments of `tesaki impedance`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use super::examples;

#[derive(Subcommand)]
pub enum Impedance {
    /// Hold the tool compliantly where it is, until Ctrl-C; then disable the outputs
    #[command(after_help = examples::IMPEDANCE)]
    Hold(Hold),
    /// Show pose and external wrench of the tool
    Status,
}

#[derive(Args)]
pub struct Hold {
    /// Impedance file, for example robots/arm7/impedances/soft.toml
    pub file: PathBuf,
    /// Disable the outputs after this time [s]; without it, hold until Ctrl-C
    #[arg(long, value_parser = super::seconds, allow_negative_numbers = true)]
    pub duration: Option<Duration>,
}
