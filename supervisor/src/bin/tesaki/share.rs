//! `share` and `key`.

use std::io;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde_json::json;
use tesaki_supervisor::BoardError;
use tesaki_supervisor::hub::Hub;
use tesaki_supervisor::port::{Address, BAUD_RATE, Key, Port, Reopening};

use crate::args::Options;
use crate::board_session::{interrupted, key_for};
use crate::failure::Failure;
use crate::output;

pub fn share(options: &Options, listen: &Address) -> Result<(), Failure> {
    let interrupted = interrupted()?;
    let key = key_for(options, &[listen, &options.port])?;
    let mut hub = Hub::listen(listen, key.as_ref()).map_err(|error| match error.kind() {
        io::ErrorKind::InvalidInput => Failure::Usage(error.to_string()),
        _ => Failure::Other(error.to_string()),
    })?;
    let mut board = Reopening::open(options.port.clone(), key)?;
    let port = board.port().map_or_else(String::new, |port| port.address().to_string());
    let (who, option) = match (hub.address(), &options.key) {
        (Address::Tcp(_), Some(path)) => {
            ("every program with this key", format!(" --key {}", path.display()))
        }
        _ => ("every program on this machine that reaches it", String::new()),
    };
    let address = reachable(hub.address());
    let host = if address.contains("HOST") { ", HOST being this machine" } else { "" };
    output::notice(
        options,
        &format!(
            "sharing {port} at {}: {who} may command the board. Connect with `--port {address}{option}`{host}; \
             Ctrl-C stops sharing",
            hub.address()
        ),
    );
    if options.json {
        output::line(&json!({ "address": hub.address().to_string() }).to_string())?;
    }
    if matches!(board.port().map(Port::address), Some(Address::Path(_))) {
        hub.limit_to(BAUD_RATE);
    }
    let (mut is_away, mut lost) = (false, board.lost());
    while !interrupted.load(Ordering::Relaxed) {
        hub.pump(&mut board, Duration::from_millis(1), Instant::now() + Duration::from_millis(200))
            .map_err(BoardError::Link)?;
        match board.error() {
            Some(error) if !is_away => {
                output::complain(&format!(
                    "the board is away: {error}\nIts port is tried again until it is there"
                ));
                is_away = true;
            }
            None if is_away && board.is_open() => {
                output::complain("the board is there again");
                is_away = false;
            }
            _ => {}
        }
        if board.is_open() && board.lost() != lost {
            output::complain(&format!(
                "{port} takes no bytes: {} of what clients sent were lost",
                board.lost().wrapping_sub(lost)
            ));
        }
        lost = board.lost();
        for message in hub.messages() {
            output::notice(options, &message);
        }
    }
    Ok(())
}

/// The address at which other programs reach this machine.
fn reachable(address: &Address) -> String {
    let text = address.to_string();
    ["0.0.0.0", "[::]"]
        .into_iter()
        .find_map(|any| {
            let port = text.strip_prefix(&format!("tcp://{any}:"))?;
            Some(format!("tcp://HOST:{port}"))
        })
        .unwrap_or(text)
}

pub fn create_key(options: &Options, file: &Path) -> Result<(), Failure> {
    Key::create(file).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => Failure::Usage(format!("{}: {error}", file.display())),
        _ => Failure::written(file)(error),
    })?;
    output::result(options, &json!({ "key": file.display().to_string() }), || {
        format!(
            "{0}: a new key. Copy it to the other machines in a secure way, and give it with `--key {0}` at \
             both ends: every program with it may command the board",
            file.display()
        )
    })
}
