//! Contact forces that hold an object.

use nalgebra::{Vector3, Vector6};
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tesaki::grasp::{Contact, GraspMap, GripError, GripState, LeastGrip};

use crate::arrays::{Input, Length, output};

/// The contact forces that `least_grip` finds [N], or the twist that proves that there are none.
type Answer<'py> = (Option<Bound<'py, PyArray2<f32>>>, Option<Bound<'py, PyArray1<f32>>>);

/// Computes the smallest contact forces that hold a load, each within its friction cone.
///
/// Minimises the sum of the squared forces subject to their wrench, friction cones and limits (Hand3, section
/// 6).
///
/// Args:
///     positions: (c, 3) contacts on the object [m], 2 to 6 of them.
///     normals: (c, 3) normals of the surface, into the object, of any length.
///     load: (6,) wrench that the forces are to apply to the object: force [N] and moment about `origin`
///         [N·m].
///     friction: coefficient of friction of all contacts.
///     limit: largest normal force of a contact [N].
///     min_force: smallest normal force of a contact [N].
///     margin: unused fraction of the friction, 0 to below 1.
///     origin: (3,) point to which moments refer [m].
///
/// Returns:
///     ``(forces, None)`` with the forces on the object, (c, 3) [N], or ``(None, twist)`` with the twist,
///     (6,), that proves that no forces hold the load.
///
/// Raises:
///     ValueError: an argument's shape or value, or a load at the edge of what can be held.
#[pyfunction]
#[pyo3(signature = (positions, normals, load, *, friction=0.5, limit=10.0, min_force=0.0, margin=0.0, origin=None))]
#[expect(clippy::too_many_arguments, reason = "named by who calls")]
pub fn least_grip<'py>(
    py: Python<'py>,
    positions: &Bound<'py, PyAny>,
    normals: &Bound<'py, PyAny>,
    load: &Bound<'py, PyAny>,
    friction: f32,
    limit: f32,
    min_force: f32,
    margin: f32,
    origin: Option<&Bound<'py, PyAny>>,
) -> PyResult<Answer<'py>> {
    let points = [Length::Any("c"), Length::Just(3)];
    let positions = Input::new(positions, "positions", &points, "c contacts in x, y, z")?;
    let points = [Length::Just(positions.rows()), Length::Just(3)];
    let normals = Input::new(normals, "normals", &points, "one for each position")?;
    let load = Input::new(load, "load", &[Length::Just(6)], "force and moment")?;
    let origin =
        origin.map(|origin| Input::new(origin, "origin", &[Length::Just(3)], "x, y, z")).transpose()?;
    let origin = Vector3::from(origin.map_or([0.0; 3], |origin| origin.array()));
    let mut contacts = Vec::new();
    for (index, (position, normal)) in
        positions.values().chunks_exact(3).zip(normals.values().chunks_exact(3)).enumerate()
    {
        let [position, normal] = [position, normal].map(Vector3::from_column_slice);
        let contact = Contact::try_new(position, normal, friction, limit);
        contacts.push(contact.map_err(|error| PyValueError::new_err(format!("contact {index}: {error}")))?);
    }
    let wrong = |error: String| PyValueError::new_err(error);
    let map = GraspMap::try_new(&contacts, origin).map_err(|error| wrong(error.to_string()))?;
    let grip = LeastGrip::try_new(margin, min_force).map_err(|error| wrong(error.to_string()))?;
    match grip.solve(&map, &Vector6::from(load.array()), &mut GripState::default()) {
        Ok(grip) => {
            let forces = output(py, [contacts.len(), 3], |values| {
                for (place, force) in values.chunks_exact_mut(3).zip(&grip.forces) {
                    place.copy_from_slice(force.as_slice());
                }
            })?;
            Ok((Some(forces), None))
        }
        Err(GripError::CannotHold(certificate)) => {
            let twist = output(py, [6], |values| values.copy_from_slice(certificate.twist.as_slice()))?;
            Ok((None, Some(twist)))
        }
        Err(error) => Err(wrong(error.to_string())),
    }
}
