//! NumPy arrays as arguments and results.

use std::fmt::{Display, Write as _};

use numpy::ndarray::Dimension;
use numpy::{PyArray, PyArrayDyn, PyArrayMethods as _, PyReadonlyArrayDyn, PyUntypedArrayMethods as _};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// The expected length along an axis.
#[derive(Clone, Copy)]
pub enum Length {
    /// Any length, with its letter in messages, for example `n`.
    Any(&'static str),
    /// Exactly this length.
    Just(usize),
}

/// An array argument in single precision.
pub struct Input<'py>(PyReadonlyArrayDyn<'py, f32>);

impl<'py> Input<'py> {
    /// Reads the argument `name`. A contiguous, aligned array of float32 is used as it is; others are
    /// converted.
    ///
    /// # Errors
    /// The value has no real numbers, or another shape. The message names the argument and `what` is
    /// expected.
    pub fn new(value: &Bound<'py, PyAny>, name: &str, shape: &[Length], what: &str) -> PyResult<Self> {
        let array = contiguous(value, name)?;
        let fits = |(got, expected): (&usize, &Length)| match expected {
            Length::Any(_) => true,
            Length::Just(length) => got == length,
        };
        if array.ndim() != shape.len() || !array.shape().iter().zip(shape).all(fits) {
            return Err(PyValueError::new_err(format!(
                "{name} has the shape {}, expected {}: {what}",
                tuple(array.shape().iter().map(usize::to_string)),
                tuple(shape.iter().map(|length| match length {
                    Length::Any(letter) => (*letter).to_owned(),
                    Length::Just(length) => length.to_string(),
                })),
            )));
        }
        let array = array.readonly();
        // Whatever NumPy made of it is read as a slice from now on.
        array.as_slice()?;
        Ok(Self(array))
    }

    /// Returns the length of the first axis.
    pub fn rows(&self) -> usize {
        self.0.shape().first().copied().unwrap_or(0)
    }

    /// Returns all numbers, the last axis fastest.
    pub fn values(&self) -> &[f32] {
        // Checked by `new`.
        self.0.as_slice().unwrap_or_default()
    }

    /// Returns exactly `N` numbers.
    pub fn array<const N: usize>(&self) -> [f32; N] {
        let mut array = [0.0; N];
        array.iter_mut().zip(self.values()).for_each(|(place, value)| *place = *value);
        array
    }
}

/// Returns a contiguous and aligned array of float32: the argument itself if it is one.
pub fn contiguous<'py>(value: &Bound<'py, PyAny>, name: &str) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let numpy = value.py().import("numpy")?;
    let no_numbers =
        |why: &dyn Display| PyTypeError::new_err(format!("{name} is no array of numbers: {why}"));
    let given = numpy.call_method1("asanyarray", (value,)).map_err(|error| no_numbers(&error))?;
    if given.is_instance(&numpy.getattr("ma")?.getattr("MaskedArray")?)? {
        return Err(no_numbers(&"it is masked"));
    }
    let kind = given.getattr("dtype")?;
    if !["b", "i", "u", "f"].contains(&kind.getattr("kind")?.extract::<String>()?.as_str()) {
        return Err(no_numbers(&format!("its type is {kind}")));
    }
    let array = numpy.call_method1("ascontiguousarray", (given, "float32"))?;
    // A field of packed records can be contiguous, and yet at odd addresses.
    let array = numpy.call_method1("require", (array, "float32", "A"))?;
    Ok(array.cast_into()?)
}

/// Formats a tuple as Python does.
fn tuple(parts: impl Iterator<Item = String>) -> String {
    let parts: Vec<String> = parts.collect();
    let mut text = format!("({}", parts.join(", "));
    let _ = write!(text, "{})", if parts.len() == 1 { "," } else { "" });
    text
}

/// Checks an argument that must have as many rows as another one.
pub fn same_rows(name: &str, rows: usize, other: &str, expected: usize) -> PyResult<()> {
    if rows == expected {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("{name} has {rows} rows, but {other} has {expected}: one for each")))
}

/// Returns an array whose numbers `fill` computes while other Python threads run.
pub fn output<'py, D: Dimension>(
    py: Python<'py>,
    shape: impl numpy::ndarray::IntoDimension<Dim = D>,
    fill: impl FnOnce(&mut [f32]) + Send,
) -> PyResult<Bound<'py, PyArray<f32, D>>> {
    let array = PyArray::<f32, D>::zeros(py, shape, false);
    {
        let mut writing = array.readwrite();
        let values = writing.as_slice_mut()?;
        py.detach(|| fill(values));
    }
    Ok(array)
}
