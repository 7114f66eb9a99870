//! `host-sim papers`.

use std::error::Error;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use tesaki_output::say;
use tesaki_sim::papers::{self, Drawn, Paper};
use tesaki_sim::report::{create, write};

use super::{progress_bar, seed, workspace};

#[derive(Args)]
pub struct Papers {
    /// Papers; default: all
    #[arg(value_enum)]
    papers: Vec<Paper>,
    /// Seed of the machine's deviations and noise
    #[arg(long, default_value_t = 1, value_parser = seed, allow_hyphen_values = true)]
    seed: u64,
    /// Folder for the figures, and for what was measured in the runs that they show; default: docs/papers/,
    /// whose pages are about machine 1, and out/papers for another seed
    #[arg(long)]
    out: Option<PathBuf>,
}

pub fn run(options: &Papers) -> Result<(), Box<dyn Error>> {
    let papers = if options.papers.is_empty() { Paper::value_variants() } else { &options.papers };
    let out = options.out.clone().unwrap_or_else(|| match options.seed {
        1 => workspace().join("docs/papers"),
        _ => PathBuf::from("out/papers"),
    });
    create(&out)?;
    let bar = progress_bar("figures");
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1000")]
    let progress = |fraction: f64| bar.set_position((fraction * 1000.0) as u64);
    let Drawn { runs, files } = papers::draw(papers, &workspace().join("robots"), options.seed, &progress)?;
    bar.finish_and_clear();
    let runs =
        runs.iter().map(|run| Ok((format!("{}.json", run.scenario), serde_json::to_string(run)? + "\n")));
    let runs: Vec<(String, String)> = runs.collect::<Result<_, serde_json::Error>>()?;
    write(&out, &files)?;
    write(&out.join("runs"), &runs)?;
    for (name, _) in files {
        say!("{}", out.join(name).display());
    }
    Ok(())
}
