//! `tesaki`: the supervisor's command line.

mod approach;
mod args;
mod board;
mod board_session;
mod calibrate;
mod check;
mod doctor;
mod eval;
mod failure;
mod feed;
mod find_circle;
mod follow;
mod foxglove;
mod glove;
mod grasp;
mod home;
mod identify;
mod impedance;
mod init;
mod joints;
mod look;
mod model;
mod motion;
mod output;
mod parameter;
mod reach;
mod recording;
mod replay;
mod retarget;
mod ros2;
mod share;
mod sight;
mod view;
mod watch;

use std::process::ExitCode;

use args::{Cli, Command, Listen, ModelCommand};
use failure::Failure;

fn main() -> ExitCode {
    let cli = Cli::read();
    let result = run(&cli).map_err(|failure| failure.through(&cli.options.port));
    if let Err(failure) = &result {
        output::failure(&cli.options, failure);
    }
    let written = output::flush(matches!(result, Err(Failure::Stalled)));
    match (result, written) {
        // Who reads only a part of the result is told by the code what it was.
        (Ok(code), Ok(()) | Err(Failure::Pipe)) => code,
        (Ok(_), Err(failure)) => {
            output::failure(&cli.options, &failure);
            let _ = output::flush(false);
            failure.exit_code()
        }
        (Err(failure), _) => failure.exit_code(),
    }
}

fn run(cli: &Cli) -> Result<ExitCode, Failure> {
    let options = &cli.options;
    match &cli.command {
        Command::List => board::list(options),
        Command::Info => board::info(options),
        Command::Doctor { robot } => return doctor::run(options, robot.as_deref()),
        Command::Monitor => watch::run(options),
        Command::View(args) => view::run(options, args),
        Command::Enable(args) => joints::enable(options, args),
        Command::Disable => board::disable(options),
        Command::Stop => board::stop(options),
        Command::Move(args) => joints::move_joints(options, args),
        Command::Reach(args) => reach::run(options, args),
        Command::Grasp(command) => grasp::run(options, command),
        Command::Identify(args) => identify::run(options, args),
        Command::Calibrate(args) => calibrate::run(options, args),
        Command::Retarget(args) => retarget::run(options, args),
        Command::Impedance(command) => impedance::run(options, command),
        Command::Follow(args) => follow::run(options, args),
        Command::Tare => home::tare(options),
        Command::Home(args) => home::home(options, args),
        Command::Read { path } => parameter::read(options, path.as_deref()),
        Command::Set { path, value } => parameter::set(options, path, value),
        Command::Model { command } => match command {
            ModelCommand::Push { robot, chain, calibration } => {
                model::push(options, robot, chain.as_deref(), calibration.as_deref())
            }
            ModelCommand::Init(args) => return init::run(options, args),
            ModelCommand::Show => model::show(options),
            ModelCommand::Check { robot } => return check::run(options, robot),
        },
        Command::FindCircle(args) => find_circle::run(options, args),
        Command::Look(args) => look::run(options, args),
        Command::Approach(args) => approach::run(options, args),
        Command::Eval(eval) => eval::run(options, eval),
        Command::Faults { clear } => board::faults(options, *clear),
        Command::Record(args) => recording::record(options, args),
        Command::Replay { log } => replay::run(options, log),
        Command::Share { listen, robot } => match listen {
            Listen::Programs(address) => share::share(options, address),
            Listen::Foxglove(address) => foxglove::share(options, *address, robot.as_deref()),
        },
        Command::Ros2 { .. } => ros2::start(),
        Command::Key { file } => share::create_key(options, file),
        Command::Completions { shell } => args::completions(*shell),
    }
    .map(|()| ExitCode::SUCCESS)
}
