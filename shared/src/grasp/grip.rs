use core::cell::Cell;
use core::fmt;

use nalgebra::{Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::cone::Cone;
use super::search::{Search, SearchEnd, SearchState};
use super::{Certificate, ContactForces, GraspMap};
use crate::collect::collect;
use crate::math::{self, halves, stack};

/// Loads below this fraction of the minimum normal force get the absolute tolerance of a load of that size.
const MIN_LOAD: f32 = 0.01;

/// *Least grip*: the contact forces `f` that minimise `½ Σ |f|²` subject to
///
/// - the wrench `G f = w`,
/// - normal forces between `min_force` and the contact's limit,
/// - friction cones with a margin, `|f_t| ≤ μ (1 − margin) f_n`.
///
/// The problem is strictly convex: the solution is unique, and continuous in contacts and load. The forces of
/// the pseudo-inverse are orthogonal to all internal forces (Hand3 eq. 18), so it is also the solution with
/// the smallest *internal* forces.
///
/// # Algorithm
/// The dual problem has six unknowns for any number of contacts, a twist `y`, and no constraints:
/// maximise `y·w − Σ φᵢ(Gᵢᵀ y)`, where the gradient of `φᵢ` is the projection `pᵢ` on contact i's truncated
/// cone, which has a closed form. Its gradient `w − Σ Gᵢ pᵢ` is the residual of the load, and its Hessian
/// `Σ Gᵢ Pᵢ Gᵢᵀ` a 6 × 6 matrix: Newton's method (semismooth, damped, with a line search) takes a few steps
/// from the last tick's twist. The forces `pᵢ` are inside their cones at every step: the cones are not
/// linearised, and no interior point is needed. If the load is infeasible, `y` grows along a twist that
/// proves it: the [`Certificate`].
#[derive(Clone, Debug, PartialEq)]
pub struct LeastGrip {
    pub(super) margin: f32,
    pub(super) min_force: f32,
    /// Accepted residual over the load.
    pub(super) tolerance: f32,
}

/// Warm start of the next search, and a search interrupted by its budget.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct GripState {
    /// Twist about the centroid, the angular part times the length, over the load: invariant under motions of
    /// the whole grasp.
    pub(super) twist: [f32; 6],
    pub(super) search: Option<SearchState>,
}

impl GripState {
    /// No previous solution.
    pub const START: Self = Self { twist: [0.0; 6], search: None };
}

/// Contact forces that balance the load.
#[derive(Clone, Debug, PartialEq)]
pub struct Grip {
    /// The contacts' forces on the object [N].
    pub forces: ContactForces,
    /// Residual wrench over the load, with moments over [`GraspMap::length`]: at most 1e-4, or the tolerance
    /// of [`LeastGrip::with_tolerance`]. For loads below a hundredth of the minimum normal force, over that
    /// hundredth.
    pub residual: f32,
    /// Number of Newton steps in all calls.
    pub steps: u8,
}

/// Why the settings of a [`LeastGrip`] are invalid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InvalidGripSettings {
    /// The friction margin is outside 0 (inclusive) to 1 (exclusive).
    Margin(f32),
    /// The minimum normal force is negative or not finite.
    MinForce(f32),
    /// The accepted residual is negative, or above 1.
    Tolerance(f32),
}

/// Why [`LeastGrip`] returned no forces.
#[derive(Clone, Debug, PartialEq)]
pub enum GripError {
    /// The load is not finite.
    NotFinite,
    /// The limit of a contact is below the minimum normal force.
    Limit {
        /// Its index.
        contact: u8,
        /// Its limit [N].
        limit: f32,
    },
    /// The load is infeasible; the certificate proves it.
    CannotHold(Certificate),
    /// Not converged: the load is at the boundary of the feasible set, or the forces would exceed some twenty
    /// times the load, beyond single precision. The next search starts cold.
    NotConverged {
        /// Smallest residual over the load, with moments over [`GraspMap::length`].
        residual: f32,
    },
    /// The budget is used up; the next call continues.
    Unfinished {
        /// Present residual over the load, with moments over [`GraspMap::length`].
        residual: f32,
    },
}

impl LeastGrip {
    /// Sets `margin`, the unused fraction of the friction, 0 (inclusive) to 1 (exclusive), and `min_force`,
    /// the minimum normal force of each contact [N], which keeps it closed.
    ///
    /// # Errors
    /// The first invalid value.
    pub fn try_new(margin: f32, min_force: f32) -> Result<Self, InvalidGripSettings> {
        if !(0.0..1.0).contains(&margin) {
            return Err(InvalidGripSettings::Margin(margin));
        }
        if !(min_force >= 0.0 && min_force.is_finite()) {
            return Err(InvalidGripSettings::MinForce(min_force));
        }
        Ok(Self { margin, min_force, tolerance: 0.0 })
    }

    /// Accepts a residual of `fraction` of the load, and twice that as duality gap. For a measured load that
    /// changes in every tick: a search for full accuracy with one step per tick would never finish.
    ///
    /// # Errors
    /// The fraction is not within 0 to 1.
    pub fn with_tolerance(self, fraction: f32) -> Result<Self, InvalidGripSettings> {
        if !(0.0..=1.0).contains(&fraction) {
            return Err(InvalidGripSettings::Tolerance(fraction));
        }
        Ok(Self { tolerance: fraction, ..self })
    }

    /// Solves for the contact forces that apply the wrench `load` [N; N·m] to the object: the opposite of
    /// gravity and inertia.
    ///
    /// # Errors
    /// The load is infeasible, or at the boundary of the feasible set.
    pub fn solve(
        &self,
        map: &GraspMap,
        load: &Vector6<f32>,
        state: &mut GripState,
    ) -> Result<Grip, GripError> {
        self.advance(map, load, state, u32::MAX)
    }

    /// Like [`Self::solve`] with a budget: returns before the Newton step that might exceed
    /// `max_instructions` instructions of a Cortex-M4F, counted by a cost model that is identical on all
    /// machines. Takes at least one step: up to 17 000 instructions with three contacts, 24 000 with six. The
    /// next call continues with its own contacts and load. All calls together take at most 39 steps.
    ///
    /// # Errors
    /// As above, or [`GripError::Unfinished`].
    pub fn advance(
        &self,
        map: &GraspMap,
        load: &Vector6<f32>,
        state: &mut GripState,
        max_instructions: u32,
    ) -> Result<Grip, GripError> {
        if !load.sum().is_finite() {
            return Err(GripError::NotFinite);
        }
        for (index, contact) in (0..).zip(map.contacts()) {
            if contact.limit() < self.min_force {
                return Err(GripError::Limit { contact: index, limit: contact.limit() });
            }
        }
        let (force, moment) = map.scaled(load);
        let norm = math::sqrt(force.norm_squared() + moment.norm_squared());
        let unit = if norm > self.min_force { norm } else { self.min_force };
        if unit <= f32::MIN_POSITIVE {
            state.search = None;
            let forces = collect(map.contacts().iter().map(|_| Vector3::zeros()));
            return Ok(Grip { forces, residual: 0.0, steps: 0 });
        }
        let cone = |contact| Cone::new(contact, self.margin, self.min_force, unit);
        let search = Search {
            map,
            cones: collect(map.contacts().iter().map(cone)),
            load: stack([force / unit, moment / unit]),
            norm: if norm > MIN_LOAD * unit { norm / unit } else { MIN_LOAD },
            tolerance: self.tolerance,
            work: Cell::new(0),
        };
        let proves = |y: &Vector6<f32>| {
            let [linear, angular] = halves(y);
            let certificate = Certificate { twist: stack([linear, angular / map.length]) };
            certificate.is_valid(self, map, load).then_some(certificate)
        };
        let mut running = state.search.take().unwrap_or_else(|| SearchState::at(state.twist));
        if running.is_corrupt() {
            running.restart();
        }
        match search.run(&mut running, max_instructions, proves) {
            Ok(point) => {
                state.twist = point.twist.into();
                let forces = collect(point.nearest.iter().map(|nearest| nearest.force * unit));
                Ok(Grip { forces, residual: search.residual(&point), steps: running.steps })
            }
            Err(SearchEnd::Infeasible(certificate)) => Err(GripError::CannotHold(certificate)),
            Err(SearchEnd::NotConverged(residual)) => {
                *state = GripState::default();
                Err(GripError::NotConverged { residual })
            }
            Err(SearchEnd::Unfinished(residual)) => {
                state.search = Some(running);
                Err(GripError::Unfinished { residual })
            }
        }
    }
}

impl fmt::Display for InvalidGripSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Margin(value) => {
                write!(f, "the friction margin is {value}; it must be at least 0 and less than 1")
            }
            Self::MinForce(value) => {
                write!(f, "the minimum normal force is {value} N; it must be finite and not negative")
            }
            Self::Tolerance(value) => {
                write!(f, "the accepted residual is {value} of the load; it must be 0 to 1")
            }
        }
    }
}

impl core::error::Error for InvalidGripSettings {}

impl fmt::Display for GripError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "the load is not finite"),
            Self::Limit { contact, limit } => {
                write!(f, "contact {contact}: its limit of {limit} N is below the minimum normal force")
            }
            Self::CannotHold(certificate) => {
                let t = certificate.twist;
                write!(
                    f,
                    "no contact forces hold the load against the twist {} {} {} m/s, {} {} {} rad/s",
                    t.x, t.y, t.z, t.w, t.a, t.b
                )
            }
            Self::NotConverged { residual } => {
                write!(f, "the load is at the boundary of the feasible set: the residual is {residual} of it")
            }
            Self::Unfinished { residual } => {
                write!(f, "the search is not finished: the residual is {residual} of the load so far")
            }
        }
    }
}

impl core::error::Error for GripError {}
