//! `host-sim speed`.

use std::error::Error;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use clap::Args;
use comfy_table::Table;
use tesaki::protocol::ActuatorFrame;
use tesaki_output::say;
use tesaki_sim::controller::{Native, Watched};
use tesaki_sim::law::LawFile;
use tesaki_sim::plant::{CONTROL_PERIOD, Intervention, Plant};
use tesaki_sim::scenario::{Scenario, Setting};

use super::{find_scenario, seed, workspace};

/// An arm alone and against walls, a hand, a hand with an object.
const SCENARIOS: [&str; 6] =
    ["arm7-elbow", "arm7-follow", "arm7-wall", "hand3-servo", "hand3-turn", "hand3-weights"];

#[derive(Args)]
pub struct Speed {
    /// Names of scenarios, see `cargo sim list`
    #[arg(default_values = SCENARIOS)]
    scenarios: Vec<String>,
    /// Seed of the machine
    #[arg(long, default_value = "1", value_parser = seed, allow_hyphen_values = true)]
    seed: u64,
    /// How often each is run; the fastest run counts
    #[arg(long, default_value = "3", value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
}

/// Measures how many seconds of a machine one core simulates in a second of its time: plant, control core,
/// and what the scenario records of both; without the report.
pub fn run(options: &Speed) -> Result<(), Box<dyn Error>> {
    let mut table = Table::new();
    table.load_style(comfy_table::presets::NOTHING);
    table.set_header(["scenario", "simulated s", "CPU s", "simulated s a CPU s"]);
    for name in &options.scenarios {
        let scenario = find_scenario(name)?;
        let mut best: Option<(f64, f64)> = None;
        for _ in 0..options.runs {
            let run = measure(scenario, options.seed)?;
            best = best.filter(|best| best.1 <= run.1).or(Some(run));
        }
        if let Some((simulated, cpu)) = best {
            let cells = [format!("{simulated:.1}"), format!("{cpu:.2}"), format!("{:.0}", simulated / cpu)];
            table.add_row(std::iter::once(name.clone()).chain(cells));
        }
    }
    say!("{table}");
    Ok(())
}

/// Simulated time of all machines of a scenario, and CPU time of this process [s].
fn measure(scenario: &Scenario, seed: u64) -> Result<(f64, f64), Box<dyn Error>> {
    let robot = workspace().join("robots").join(scenario.robot);
    let laws = LawFile::find(scenario, &robot, &[])?;
    let periods = Arc::new(Mutex::new(Periods(0)));
    let mut native = Native::default();
    let mut watched = Watched::new(&mut native, false);
    let plain = Setting::plain(&robot, &mut watched, seed, scenario.duration);
    let mut setting = Setting { laws: &laws, intervention: Some(Arc::clone(&periods) as _), ..plain };
    let (begin, before) = (Instant::now(), cpu_time(Path::new("/proc/self/stat")));
    scenario.run(&mut setting)?;
    let cpu = cpu_time(Path::new("/proc/self/stat")).zip(before).map(|(now, before)| now - before);
    let simulated = f64::from(periods.lock().unwrap_or_else(PoisonError::into_inner).0) * CONTROL_PERIOD;
    Ok((simulated, cpu.unwrap_or_else(|| begin.elapsed().as_secs_f64())))
}

/// Counts control periods.
struct Periods(u32);

impl Intervention for Periods {
    fn attach(&mut self, _: &mut Plant) {}

    fn before(&mut self, _: &mut Plant, _: &mut ActuatorFrame) -> bool {
        true
    }

    fn after(&mut self, _: &Plant) {
        self.0 += 1;
    }
}

/// User and system time of a process [s], from its file in Linux' `/proc`; `None` elsewhere.
fn cpu_time(stat: &Path) -> Option<f64> {
    // The name of the program, in parentheses, may have blanks in it. proc(5): fields 14 and 15, in 1/100 s.
    let stat = std::fs::read_to_string(stat).ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / 100.0)
}
