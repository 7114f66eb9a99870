//! The Python package `tesaki`: robots, boards and scenarios, with the control core's own numbers.
//!
//! Each module holds the classes and functions that Python sees; their doc comments are Python's docstrings,
//! and `tesaki/_tesaki.pyi` their types. Parts that need only Python (environments, recordings) are in
//! `tesaki/`.
//!
//! Arrays are passed without a copy, in single precision as the core computes. Long waits and computations
//! let other Python threads run.
#![allow(clippy::disallowed_methods, reason = "not the control core")]

mod arrays;
mod board;
mod command;
mod error;
mod grip;
mod robot;
mod sim;
mod value;

use pyo3::pymodule;

#[pymodule]
mod _tesaki {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::board::Board;
    #[pymodule_export]
    use crate::error::{BoardError, FaultError, FileError, RefusedError, SimulationError, TesakiError};
    #[pymodule_export]
    use crate::grip::least_grip;
    #[pymodule_export]
    use crate::robot::Robot;
    #[pymodule_export]
    use crate::sim::{Run, scenarios};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
