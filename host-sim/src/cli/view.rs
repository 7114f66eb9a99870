//! `run --view`: the run on a page in a browser while it is computed.

use std::error::Error;
use std::net::{SocketAddr, ToSocketAddrs as _};

use tesaki_description::robot::RobotFolder;
use tesaki_output::{note, say};
use tesaki_sim::live_run::{self, About, LiveRun};
use tesaki_sim::scenario::Scenario;

use super::run::{OtherRobot, Run, compute};
use super::{interrupt, robot_folder};

/// Where the page is unless it is said.
pub const ADDRESS: &str = "localhost:7481";

pub fn address(text: &str) -> Result<SocketAddr, String> {
    let mut found =
        text.to_socket_addrs().map_err(|error| format!("{error}; expected HOST:PORT, such as {ADDRESS}"))?;
    found.next().ok_or_else(|| "it has no address".to_owned())
}

/// Runs a scenario, shows it, and stays until Ctrl-C; `false` if a metric failed.
pub fn run(scenario: &Scenario, options: &Run, address: SocketAddr) -> Result<bool, Box<dyn Error>> {
    let (first, last) = (*options.seed.start(), *options.seed.end());
    if first != last {
        return Err(format!(
            "--view shows the run of one machine, not of the seeds {first}-{last}: give one, as in --seed {first}"
        )
        .into());
    }
    let folder = RobotFolder::load(&robot_folder(scenario, options.robot.as_deref())?)?;
    let other = OtherRobot::of(scenario, options)?.map(|other| other.title(scenario));
    let about = About {
        title: other.as_deref().unwrap_or(scenario.title),
        scenario: scenario.name,
        about: scenario.about,
        controller: options.controller.name(),
        seed: first,
        scene: tesaki_viewer::Scene::new(&folder.model).with_solids(&folder.urdf),
    };
    let live = LiveRun::default();
    let address = live_run::serve(address, &about, live.clone())?;
    say!("http://{address}");
    let result = interrupt::told(compute(scenario, options, Some(&live)));
    if interrupt::asked() {
        return result;
    }
    if let Err(error) = &result {
        if !live.has_begun() {
            return result;
        }
        live.fail(&error.to_string());
        note!("host-sim: {error}");
    }
    note!("Ctrl-C ends the page");
    // Until here, Ctrl-C ends the run.
    interrupt::handle()?;
    interrupt::wait();
    result.map_err(|_| "the run had ended with the error above".into())
}
