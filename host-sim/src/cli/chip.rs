//! `host-sim chip`.

use std::error::Error;
use std::io::IsTerminal;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::Args;
use rayon::iter::{Either, IntoParallelIterator, ParallelIterator};
use sha2::{Digest, Sha256};
use tesaki_output::say;
use tesaki_sim::chip::read_image;
use tesaki_sim::report::{Summary, table};
use tesaki_sim::scenario::finger_on_chip::{self, Programs};

use super::{seeds, target, workspace};

#[derive(Args)]
pub struct Chip {
    /// Seed of the machine's deviations and noise; a range such as 1-20 runs all of them
    #[arg(long, default_value = "1", value_parser = seeds, allow_hyphen_values = true)]
    seed: RangeInclusive<u64>,
    /// Print one JSON object per seed instead of the table
    #[arg(long)]
    json: bool,
    /// Robot folder, of which the first chain is taken; default: robots/hand3
    #[arg(long)]
    robot: Option<PathBuf>,
    /// Image of `board-weact`
    #[arg(
        long, env = "TESAKI_WEACT_ELF",
        default_value_os_t = target().join("thumbv7em-none-eabihf/firmware/tesaki-firmware-board-weact")
    )]
    elf: PathBuf,
    /// The modelled chip
    #[arg(long, env = "TESAKI_CHIP", default_value_os_t = target().join("chip/release/tesaki-chip"))]
    chip: PathBuf,
}

/// Runs the finger on each seed; `false` if a metric failed. What came to its end is printed also where
/// another seed did not.
pub fn run(options: &Chip) -> Result<bool, Box<dyn Error>> {
    let robot = options.robot.clone().unwrap_or_else(|| workspace().join("robots/hand3"));
    let programs = Programs { chip: &options.chip, image: &options.elf };
    let image = read_image(&options.elf)?;
    let digest = format!("{:x}", Sha256::digest(image));
    let run = |seed| match finger_on_chip::run(&robot, seed, programs) {
        Ok(summary) => Either::Left(summary.elf_sha256(&digest)),
        Err(error) => Either::Right(format!("seed {seed}: {error}")),
    };
    let (summaries, errors): (Vec<_>, Vec<_>) = options.seed.clone().into_par_iter().partition_map(run);
    if options.json {
        for summary in &summaries {
            say!("{}", serde_json::to_string(summary)?);
        }
    } else if !summaries.is_empty() {
        let colour = std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
        say!("{}", table(&summaries, colour));
    }
    if !errors.is_empty() {
        return Err(errors.join("\n").into());
    }
    Ok(summaries.iter().all(Summary::pass))
}
