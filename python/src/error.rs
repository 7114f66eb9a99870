//! Errors as exceptions, in the words of the Rust library.

use std::error::Error;

use pyo3::exceptions::PyException;
use pyo3::{PyErr, create_exception};
use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Refusal};
use tesaki_supervisor::words::named;
use tesaki_supervisor::{BoardError as Failure, troubleshooting};

create_exception!(tesaki, TesakiError, PyException, "What tesaki cannot do, and why.");
create_exception!(tesaki, FileError, TesakiError, "A robot folder or another file cannot be used.");
create_exception!(tesaki, BoardError, TesakiError, "A board does not answer, or its link failed.");
create_exception!(tesaki, RefusedError, BoardError, "The board refused a request; nothing has changed.");
create_exception!(tesaki, FaultError, BoardError, "The board is in fault: its task has ended.");
create_exception!(tesaki, SimulationError, TesakiError, "A scenario did not come to its end.");

/// Converts an error to a [`FileError`].
pub fn file(error: impl Error) -> PyErr {
    FileError::new_err(error.to_string())
}

/// Converts an error to a [`BoardError`], with the entry of the document that explains a refusal.
pub fn board(error: impl Into<Failure>) -> PyErr {
    board_of(None, error)
}

/// The same, with the names of joints and tips of the model on the board.
pub fn board_of(model: Option<&RobotModel>, error: impl Into<Failure>) -> PyErr {
    match error.into() {
        Failure::Refused { action, refusal } => {
            let entry = troubleshooting::refusal(&refusal);
            let hint = match refusal {
                Refusal::WrongMode(Mode::Disabled) => ": call enable() first",
                Refusal::Commanded { .. } => ": Board(…, take_over=True) takes command",
                Refusal::NotHomed { .. } => ": call home() first",
                _ => "",
            };
            // A refused model is another one than that on the board.
            let model = model.filter(|_| !matches!(refusal, Refusal::Model(_)));
            let text = named(&refusal, &Failure::Refused { action, refusal }.to_string(), model);
            RefusedError::new_err(format!("{text}{hint}; see {entry}"))
        }
        Failure::Reset => BoardError::new_err(
            "the board was reset meanwhile, and has lost its model: push() it again, home() and tare()",
        ),
        error => BoardError::new_err(error.to_string()),
    }
}
