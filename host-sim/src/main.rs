//! The simulator: `host-sim` alone shows what it can do.

mod cli;

use std::process::ExitCode;

use tesaki_output::note;

fn main() -> ExitCode {
    match cli::run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            note!("host-sim: {error}");
            ExitCode::from(2)
        }
    }
}
