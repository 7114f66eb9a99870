//! Errors as exceptions, in the words of the Rust library.

use std::error::Error;

use pyo3::exceptions::PyException;
use pyo3::{PyErr, create_exception};
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
    match error.into() {
        Failure::Refused { action, refusal } => {
            let entry = troubleshooting::refusal(&refusal);
            RefusedError::new_err(format!("{}; see {entry}", Failure::Refused { action, refusal }))
        }
        error => BoardError::new_err(error.to_string()),
    }
}
