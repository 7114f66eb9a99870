use core::cell::Cell;
use core::fmt;

use nalgebra::{Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::cone::Cone;
use super::map::{halves, stack};
use super::search::{Search, SearchEnd, SearchState};
use super::{Certificate, ContactForces, GraspMap};
use crate::math;

/// Loads smaller than this share of the least normal force are balanced as exactly as one of that size.
const MIN_LOAD: f32 = 0.01;

/// *Least grip*: the contact forces `f` that minimise `½ Σ |f|²` subject to
///
/// - the wrench `G f = w`,
/// - normal forces between `least` and the contact's limit,
/// - friction cones with a margin, `|f_t| ≤ μ (1 − margin) f_n`.
///
/// This is strictly convex, so there is exactly one answer and it moves steadily with contacts and load; and
/// because the pseudo-inverse's part is at right angles to all internal forces (Hand3 (18)), it is also the
/// answer with the smallest *internal* force.
///
/// # How
/// The dual problem has six unknowns however many contacts there are, a twist `y`, and no constraints:
/// maximise `y·w − Σ φᵢ(Gᵢᵀ y)`, where the gradient of `φᵢ` is the projection `pᵢ` on contact i's truncated
/// cone, which has a closed form. Its gradient `w − Σ Gᵢ pᵢ` is what is missing to the load, and its Hessian
/// `Σ Gᵢ Pᵢ Gᵢᵀ` a 6 × 6 matrix: Newton's method (semismooth, damped, with a line search) takes a few steps
/// from the last tick's twist. The forces `pᵢ` are inside their cones at every step; there is no
/// linearisation of the cones and no interior to find first. Where nothing holds the load `y` grows along a
/// twist that proves it: the [`Certificate`].
#[derive(Clone, Debug, PartialEq)]
pub struct LeastGrip {
    pub(super) margin: f32,
    pub(super) least: f32,
    /// What an answer may leave open.
    pub(super) open: f32,
}

/// The last solution's twist, from which the next search starts, and the search that a call has left off.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct GripState {
    /// About the contacts' centroid, the angular half times the length, over the load: so it stays the same
    /// when the whole grasp moves.
    pub(super) twist: [f32; 6],
    pub(super) begun: Option<SearchState>,
}

impl GripState {
    /// No previous solution.
    pub const START: Self = Self { twist: [0.0; 6], begun: None };
}

/// Contact forces that balance the load.
#[derive(Clone, Debug, PartialEq)]
pub struct Grip {
    /// The contacts' forces on the object [N].
    pub forces: ContactForces,
    /// What is missing to the load, over the load, with moments over
    /// [`GraspMap::length`]: at most 1e-4, or what [`LeastGrip::with_tolerance`] allows. A load below a
    /// hundredth of the least normal force counts as that much.
    pub residual: f32,
    /// Newton steps taken, in all calls.
    pub steps: u8,
}

/// Why the settings of a [`LeastGrip`] are invalid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InvalidGripSettings {
    /// The margin is not at least 0 and less than 1.
    Margin(f32),
    /// The least normal force is negative or not finite.
    MinForce(f32),
}

/// Why [`LeastGrip`] returned no forces.
#[derive(Clone, Debug, PartialEq)]
pub enum GripError {
    /// The load is not finite.
    NotFinite,
    /// A contact's limit is below the least normal force.
    Limit {
        /// Its index.
        contact: u8,
        /// Its limit [N].
        limit: f32,
    },
    /// No forces hold the load, and this proves it.
    CannotHold(Certificate),
    /// Neither forces nor proof were found: the load is at the edge of what can be held, or only forces of
    /// more than some twenty times its size could hold it, for which single precision has not the digits. The
    /// next search starts anew.
    NotConverged {
        /// What is missing to the load at best, over the load, with moments over [`GraspMap::length`].
        residual: f32,
    },
    /// No answer yet: the next call goes on.
    Unfinished {
        /// What is missing to the load so far, over the load, with moments over [`GraspMap::length`].
        residual: f32,
    },
}

impl LeastGrip {
    /// What [`Self::advance`] may take of a tick: enough for about four steps with three contacts.
    pub const INSTRUCTIONS_PER_TICK: u32 = 25_000;

    /// A grip that leaves `margin` of the friction unused (0 to 1) and pushes with at least `least` [N] at
    /// each contact, so that none is lost.
    ///
    /// # Errors
    /// Which of them cannot be.
    pub fn try_new(margin: f32, least: f32) -> Result<Self, InvalidGripSettings> {
        if !(0.0..1.0).contains(&margin) {
            return Err(InvalidGripSettings::Margin(margin));
        }
        if !(least >= 0.0 && least.is_finite()) {
            return Err(InvalidGripSettings::MinForce(least));
        }
        Ok(Self { margin, least, open: 0.0 })
    }

    /// The same, content with forces that leave up to this `share` of the load missing, and twice that of the
    /// sum of squares unknown. A load that is measured changes from tick to tick: a search for all digits
    /// that makes a step a tick runs after it for ever, while each of its steps is good enough.
    #[must_use]
    pub const fn with_tolerance(self, fraction: f32) -> Self {
        Self { open: fraction, ..self }
    }

    /// The least forces of the contacts of `map` that make the wrench `load` [N; N·m] on the object: the
    /// opposite of what gravity and inertia do to it.
    ///
    /// # Errors
    /// Nothing holds the load, or it is at the edge of what can be held.
    pub fn solve(
        &self,
        map: &GraspMap,
        load: &Vector6<f32>,
        state: &mut GripState,
    ) -> Result<Grip, GripError> {
        self.advance(map, load, state, u32::MAX)
    }

    /// Like [`Self::solve`], but ends when a further Newton step might take the call beyond `most`
    /// instructions of a Cortex-M4F, as counted by the kinds of work, alike on all machines. A call takes at
    /// least one step: up to 17 000 instructions with three contacts, 24 000 with six. The next call goes on,
    /// with the contacts and the load that it is given. All calls together take no more steps than one of
    /// [`Self::solve`], at most 39.
    ///
    /// # Errors
    /// As above, or [`GripError::Unfinished`].
    pub fn advance(
        &self,
        map: &GraspMap,
        load: &Vector6<f32>,
        state: &mut GripState,
        most: u32,
    ) -> Result<Grip, GripError> {
        if !load.sum().is_finite() {
            return Err(GripError::NotFinite);
        }
        for (contact, of) in (0..).zip(map.contacts()) {
            if of.limit() < self.least {
                return Err(GripError::Limit { contact, limit: of.limit() });
            }
        }
        let (force, moment) = map.scaled(load);
        let size = math::sqrt(force.norm_squared() + moment.norm_squared());
        let unit = if size > self.least { size } else { self.least };
        if unit <= f32::MIN_POSITIVE {
            state.begun = None;
            let forces = map.contacts().iter().map(|_| Vector3::zeros()).collect();
            return Ok(Grip { forces, residual: 0.0, steps: 0 });
        }
        let cone = |contact| Cone::new(contact, self.margin, self.least, unit);
        let search = Search {
            map,
            cones: map.contacts().iter().map(cone).collect(),
            load: stack(&(force / unit), &(moment / unit)),
            size: if size > MIN_LOAD * unit { size / unit } else { MIN_LOAD },
            open: self.open,
            work: Cell::new(0),
        };
        let proves = |y: &Vector6<f32>| {
            let (linear, angular) = halves(y);
            let certificate = Certificate { twist: stack(&linear, &(angular / map.length)) };
            certificate.is_valid(self, map, load).then_some(certificate)
        };
        let mut begun = state.begun.take().unwrap_or_else(|| SearchState::at(state.twist));
        if begun.is_broken() {
            begun.restart();
        }
        match search.run(&mut begun, most, proves) {
            Ok(point) => {
                state.twist = point.twist.into();
                let forces = point.nearest.iter().map(|nearest| nearest.force * unit).collect();
                Ok(Grip { forces, residual: search.residual(&point), steps: begun.steps })
            }
            Err(SearchEnd::Refused(certificate)) => Err(GripError::CannotHold(certificate)),
            Err(SearchEnd::Open(residual)) => {
                *state = GripState::default();
                Err(GripError::NotConverged { residual })
            }
            Err(SearchEnd::Unfinished(residual)) => {
                state.begun = Some(begun);
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
        }
    }
}

impl core::error::Error for InvalidGripSettings {}

impl fmt::Display for GripError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "the load is not finite"),
            Self::Limit { contact, limit } => {
                write!(f, "contact {contact}: its limit of {limit} N is below the least normal force")
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
                write!(f, "the load is at the edge of what can be held: {residual} of it is missing")
            }
            Self::Unfinished { residual } => {
                write!(f, "no answer yet: {residual} of the load is missing so far")
            }
        }
    }
}

impl core::error::Error for GripError {}
