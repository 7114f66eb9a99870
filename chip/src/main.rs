//! `tesaki-chip IMAGE`: runs the image of `board-weact` for a simulated machine that is connected to standard
//! input and output.

use std::io::{self, BufReader, BufWriter};
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (Some(image), None) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: tesaki-chip IMAGE; host-sim starts it, see chip/README.md");
        return ExitCode::from(2);
    };
    let served = std::fs::read(&image).map_err(|error| format!("{image}: {error}")).and_then(|elf| {
        let (mut from, mut to) = (BufReader::new(io::stdin()), BufWriter::new(io::stdout()));
        tesaki_chip::server::serve(&elf, &mut from, &mut to)
    });
    match served {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("tesaki-chip: {error}");
            ExitCode::from(1)
        }
    }
}
