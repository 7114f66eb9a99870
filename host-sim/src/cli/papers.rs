//! `host-sim papers`.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;
use sha2::{Digest, Sha256};
use tesaki_output::say;
use tesaki_sim::papers::{self, Drawn, Paper};
use tesaki_sim::report::{Summary, create, write};

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

/// What is kept of a run.
#[derive(Serialize)]
struct Kept<'a> {
    #[serde(flatten)]
    run: &'a Summary,
    /// SHA-256 of the files that show it.
    figures: BTreeMap<&'a str, String>,
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
    let drawn = papers::draw(papers, &workspace().join("robots"), options.seed, &progress)?;
    bar.finish_and_clear();
    for Drawn { run, files } in drawn {
        let digests = files.iter().map(|(name, svg)| (&**name, format!("{:x}", Sha256::digest(svg))));
        let kept = serde_json::to_string(&Kept { run: &run, figures: digests.collect() })? + "\n";
        write(&out.join("runs"), &[(format!("{}.json", run.scenario), kept)])?;
        for path in write(&out, &files)? {
            say!("{}", path.display());
        }
    }
    Ok(())
}
