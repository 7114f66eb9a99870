//! Constraints on the velocities of a machine: dry friction, end stops and contacts with Coulomb friction.
//!
//! The unknowns are the impulses λ of one sub-step. With them, the constrained velocities are `w = A λ + b`:
//! `A` contains the response of each velocity to each impulse, and on its diagonal the compliances; `b` are
//! the velocities without impulses. The impulses satisfy
//!
//! - dry friction of a joint, and its stop: `w = 0`, or λ is at a bound, and `w` has the sign that would
//!   drive it beyond;
//! - contact: along the normal, `w = 0` and `λ ≥ 0`, or `w ≥ 0` and `λ = 0`; across it, the two impulses of
//!   friction are within μ times that of the normal, and `w = 0`, or they are at that limit and opposed to
//!   `w`.
//!
//! Each condition is equivalent to `λ = projection of λ − r w` for any `r > 0`. [`Constraints::solve`] finds
//! the zero of these equations by Newton's method, in which each constraint has the state that the last
//! impulses give it (Alart and Curnier, Comput. Methods Appl. Mech. Engrg. 92, 1991): when no state changes
//! and nothing slides, one step is exact but for the proximity. Where friction and contacts together
//! determine more than there is freedom, impulses close to those of the last sub-step are found. If the
//! states do not settle, projected Gauss–Seidel sweeps come between the steps, and the best impulses of a few
//! rounds are taken.

use rapier3d::na::{Vector2, Vector3};

/// Largest residual of a solution, as a velocity [m/s or rad/s].
const TOLERANCE: f64 = 1e-8;
/// Weight of the distance from the impulses at the start of a round, relative to the diagonal of `A`.
const PROXIMITY: f64 = 1e-6;
/// Least response of a contact's velocity to a unit impulse [1/kg]: more than 10 t do not move. It follows
/// that a contact in a direction in which nothing can move has a solution.
const MIN_RESPONSE: f64 = 1e-4;
/// Bias of the normal of a contact without a force [m/s].
const APART: f64 = 1e3;
/// Newton steps of a round, sweeps between rounds, and rounds.
const STEPS: usize = 6;
const SWEEPS: usize = 8;
const ROUNDS: usize = 6;

/// A velocity that is constrained, of links relative to an object or a fixed body.
#[derive(Default)]
pub struct Row {
    /// The multibody of the links; any if there are none.
    pub chain: usize,
    /// Its derivatives with respect to the joint velocities of the multibody, and their changes under a unit
    /// impulse; empty without links.
    pub links: Vec<f64>,
    pub links_response: Vec<f64>,
    pub object: Option<ObjectRow>,
    /// Added to the velocity [m/s or rad/s].
    pub bias: f64,
    /// Added to the velocity per impulse [1/kg or 1/(kg·m²)].
    pub compliance: f64,
    /// Bounds of the impulse of a joint [N·m·s].
    pub bounds: [f64; 2],
    /// Impulse [N·s or N·m·s]: of the last sub-step (0 of a stop), until that of this one is known.
    pub impulse: f64,
    /// The constrained velocity, with bias and compliance [m/s or rad/s].
    pub velocity: f64,
}

/// The part of the object in a constrained velocity: derivatives with respect to its linear and angular
/// velocity, and their changes under a unit impulse.
pub struct ObjectRow {
    pub linear: Vector3<f64>,
    pub angular: Vector3<f64>,
    pub linear_response: Vector3<f64>,
    pub angular_response: Vector3<f64>,
}

impl Row {
    /// Returns the response of this velocity to a unit impulse of another row, without compliance.
    fn response_to(&self, other: &Self) -> f64 {
        let of_links = if self.chain == other.chain {
            self.links.iter().zip(&other.links_response).map(|(one, other)| one * other).sum()
        } else {
            0.0
        };
        let of_object = match (&self.object, &other.object) {
            (Some(own), Some(other)) => {
                own.linear.dot(&other.linear_response) + own.angular.dot(&other.angular_response)
            }
            _ => 0.0,
        };
        of_links + of_object
    }

    /// Returns the velocity of links and object.
    pub fn of(&self, links: &[f32], [linear, angular]: &[Vector3<f64>; 2]) -> f64 {
        let links: f64 = self.links.iter().zip(links).map(|(one, other)| one * f64::from(*other)).sum();
        let of_object = self.object.as_ref();
        links + of_object.map_or(0.0, |object| object.linear.dot(linear) + object.angular.dot(angular))
    }
}

/// Computes a scalar product, with four partial sums.
fn dot(one: &[f64], other: &[f64]) -> f64 {
    let (chunks, others) = (one.as_chunks::<4>(), other.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for (one, other) in chunks.0.iter().zip(others.0) {
        for (sum, (one, other)) in sums.iter_mut().zip(one.iter().zip(other)) {
            *sum += one * other;
        }
    }
    let rest = chunks.1.iter().zip(others.1).map(|(one, other)| one * other).sum::<f64>();
    (sums[0] + sums[2]) + (sums[1] + sums[3]) + rest
}

/// The constraints of a sub-step: first those of joints, then the contacts with three rows each, the normal
/// and two directions across it.
#[derive(Default)]
pub struct Constraints {
    rows: Vec<Row>,
    /// Number of the rows of joints.
    joints: usize,
    /// Coefficient of friction of each contact.
    friction: Vec<f64>,
    /// `A` in row-major order, `b` and λ.
    responses: Vec<f64>,
    free: Vec<f64>,
    impulses: Vec<f64>,
    /// The impulses with the least residual so far.
    best: Vec<f64>,
    /// Impulses at the start of a round, and the present weight of the distance from them.
    center: Vec<f64>,
    proximity: f64,
    /// State of each row under the present impulses.
    states: Vec<State>,
    /// Of a Newton step: the rows whose impulses are unknown, the impulses of the others, which are 0 for
    /// these rows, and the equations, each with the right-hand side at its end.
    unknown: Vec<usize>,
    fixed: Vec<f64>,
    equations: Vec<f64>,
}

/// What a row requires in a Newton step.
#[derive(Clone, Copy, PartialEq)]
enum State {
    /// Its velocity is 0.
    Sticks,
    /// Its impulse is known.
    Fixed(f64),
    /// It is a direction across the normal of a contact that slides.
    Slides(Slide),
}

/// A contact that slides.
#[derive(Clone, Copy, PartialEq)]
struct Slide {
    /// Row of the normal.
    normal: usize,
    friction: f64,
    /// Direction of the friction on it.
    direction: Vector2<f64>,
    /// Limit of the friction over the length of the vector that is projected onto it.
    share: f64,
    /// The factor of `w` in that vector.
    scale: f64,
}

impl Constraints {
    /// Begins with the constraints of joints.
    pub fn begin(&mut self, joints: Vec<Row>) {
        self.joints = joints.len();
        self.rows = joints;
        self.friction.clear();
    }

    /// Adds a contact: rows of its normal and of two directions across it, its coefficient of friction, the
    /// bias of the normal, and the compliance of the normal over its response. Where nothing can move along
    /// the normal, rigid bodies determine no force: such solids count as far apart.
    pub fn add_contact(&mut self, rows: [Row; 3], friction: f64, (bias, compliance): (f64, f64)) {
        let normal = self.rows.len();
        self.rows.extend(rows);
        self.friction.push(friction);
        let row = &mut self.rows[normal];
        let response = row.response_to(row);
        row.bias = if response < MIN_RESPONSE { APART } else { bias };
        row.compliance = compliance * response;
    }

    /// All rows.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// The rows of each contact.
    pub fn contacts(&self) -> impl Iterator<Item = &[Row; 3]> {
        self.rows[self.joints..].as_chunks().0.iter()
    }

    /// Computes impulses and velocities of all rows, whose velocities without impulses and bias are those of
    /// `free`. Returns whether they meet all conditions; without impulses if a velocity is not finite.
    pub fn solve(&mut self, free: impl Fn(&Row) -> f64) -> bool {
        let rows = &self.rows;
        let size = rows.len();
        self.responses.resize(size * size, 0.0);
        for (index, row) in rows.iter().enumerate() {
            for (other, other_row) in rows[..=index].iter().enumerate() {
                let response = row.response_to(other_row);
                self.responses[index * size + other] = response;
                self.responses[other * size + index] = response;
            }
            let own = &mut self.responses[index * (size + 1)];
            *own += row.compliance;
            if index >= self.joints {
                *own = own.max(MIN_RESPONSE);
            }
        }
        self.free.clear();
        self.free.extend(rows.iter().map(|row| free(row) + row.bias));
        self.impulses.clear();
        self.impulses.extend(rows.iter().map(|row| row.impulse));
        let is_solved = if !self.free.iter().all(|velocity| velocity.is_finite()) {
            self.impulses.fill(0.0);
            false
        } else {
            self.rows.is_empty() || self.find_impulses()
        };
        for index in 0..self.rows.len() {
            let (impulse, velocity) = (self.impulses[index], self.velocity(index));
            (self.rows[index].impulse, self.rows[index].velocity) = (impulse, velocity);
        }
        is_solved
    }

    /// Velocity of a row under the present impulses.
    fn velocity(&self, row: usize) -> f64 {
        let size = self.rows.len();
        self.free[row] + dot(&self.responses[row * size..][..size], &self.impulses)
    }

    fn response(&self, row: usize, other: usize) -> f64 {
        self.responses[row * self.rows.len() + other]
    }

    fn find_impulses(&mut self) -> bool {
        let mut least = f64::INFINITY;
        self.best.clone_from(&self.impulses);
        for round in 0..ROUNDS {
            if round > 0 {
                (0..SWEEPS).for_each(|_| self.sweep());
            }
            self.proximity = PROXIMITY;
            self.center.clone_from(&self.impulses);
            let mut residual = self.evaluate();
            self.keep_best(residual, &mut least);
            for _ in 0..STEPS {
                if residual <= TOLERANCE || !self.step() {
                    break;
                }
                residual = self.evaluate();
            }
            self.proximity = 0.0;
            residual = self.evaluate();
            self.keep_best(residual, &mut least);
            if least <= TOLERANCE {
                break;
            }
        }
        self.impulses.clone_from(&self.best);
        least <= TOLERANCE
    }

    fn keep_best(&mut self, residual: f64, least: &mut f64) {
        if residual < *least && self.impulses.iter().all(|impulse| impulse.is_finite()) {
            *least = residual;
            self.best.clone_from(&self.impulses);
        }
    }

    /// Finds the state of each row under the present impulses. Returns the largest residual.
    fn evaluate(&mut self) -> f64 {
        let size = self.rows.len();
        let velocity = |row: usize| {
            let responses = &self.responses[row * size..][..size];
            let near = self.proximity * responses[row] * (self.impulses[row] - self.center[row]);
            self.free[row] + dot(responses, &self.impulses) + near
        };
        self.states.clear();
        let mut residual: f64 = 0.0;
        for row in 0..self.joints {
            let [lower, upper] = self.rows[row].bounds;
            let (impulse, gain) = (self.impulses[row], self.response(row, row));
            let unbounded = impulse - velocity(row) / gain;
            let projected = unbounded.max(lower).min(upper);
            residual = residual.max((projected - impulse).abs() * gain);
            let sticks = (lower..=upper).contains(&unbounded);
            self.states.push(if sticks { State::Sticks } else { State::Fixed(projected) });
        }
        for (contact, &friction) in self.friction.iter().enumerate() {
            let normal = self.joints + 3 * contact;
            let [one, two] = [normal + 1, normal + 2];
            let (impulse, gain) = (self.impulses[normal], self.response(normal, normal));
            let unbounded = impulse - velocity(normal) / gain;
            residual = residual.max((unbounded.max(0.0) - impulse).abs() * gain);
            let scale = 1.0 / (self.response(one, one) + self.response(two, two));
            let present = Vector2::new(self.impulses[one], self.impulses[two]);
            let across = present - scale * Vector2::new(velocity(one), velocity(two));
            let (limit, length) = (friction * impulse.max(0.0), across.norm());
            let projected = across.cap_magnitude(limit);
            residual = residual.max((projected - present).norm() / scale);
            if unbounded <= 0.0 {
                self.states.extend([State::Fixed(0.0); 3]);
                continue;
            }
            let state = if length > limit {
                let direction = across / length;
                State::Slides(Slide { normal, friction, direction, share: limit / length, scale })
            } else {
                State::Sticks
            };
            self.states.extend([State::Sticks, state, state]);
        }
        residual
    }

    /// Takes a Newton step. Returns `false` if it has no finite solution.
    fn step(&mut self) -> bool {
        let Self { states, responses, impulses, center, proximity, free, unknown, fixed, equations, .. } =
            self;
        let size = states.len();
        unknown.clear();
        fixed.clear();
        for (row, (state, impulse)) in states.iter().zip(&mut *impulses).enumerate() {
            if let State::Fixed(known) = *state {
                *impulse = known;
                fixed.push(known);
            } else {
                unknown.push(row);
                fixed.push(0.0);
            }
        }
        let responses = |row: usize| &responses[row * size..][..size];
        // Velocity under the known impulses alone.
        let known = |row: usize| {
            free[row] + dot(responses(row), fixed) - *proximity * responses(row)[row] * center[row]
        };
        equations.clear();
        for (index, &row) in unknown.iter().enumerate() {
            let begin = equations.len();
            let State::Slides(slide) = states[row] else {
                let own = responses(row);
                equations.extend(unknown.iter().map(|&other| own[other]));
                equations[begin + index] += *proximity * own[row];
                equations.push(-known(row));
                continue;
            };
            let Slide { normal, friction, direction, share, scale } = slide;
            let (tangents, axis) = ([normal + 1, normal + 2], row - normal - 1);
            // A row of the projection across the direction, scaled.
            let part = [0, 1].map(|other| {
                let unit = if other == axis { 1.0 } else { 0.0 };
                share * (unit - direction[axis] * direction[other])
            });
            let [one, two] = tangents.map(responses);
            equations.extend(unknown.iter().map(|&other| part[0] * one[other] + part[1] * two[other]));
            // The rows of a contact that slides are next to each other.
            let at = begin + index - axis - 1;
            equations[at] -= friction * direction[axis] / scale;
            for (tangent, part) in part.into_iter().enumerate() {
                let own = responses(tangents[tangent])[tangents[tangent]];
                equations[at + 1 + tangent] += part * (*proximity * own - 1.0 / scale);
            }
            equations[begin + index] += 1.0 / scale;
            equations.push(-part[0] * known(tangents[0]) - part[1] * known(tangents[1]));
        }
        if !eliminate(equations, unknown.len()) {
            return false;
        }
        let solution = equations.chunks_exact(unknown.len() + 1).filter_map(|equation| equation.last());
        for (&row, impulse) in unknown.iter().zip(solution) {
            impulses[row] = *impulse;
        }
        true
    }

    /// Meets the condition of each constraint in turn.
    fn sweep(&mut self) {
        for row in 0..self.joints {
            let [lower, upper] = self.rows[row].bounds;
            let unbounded = self.impulses[row] - self.velocity(row) / self.response(row, row);
            self.impulses[row] = unbounded.max(lower).min(upper);
        }
        for contact in 0..self.friction.len() {
            let normal = self.joints + 3 * contact;
            let [one, two] = [normal + 1, normal + 2];
            let unbounded = self.impulses[normal] - self.velocity(normal) / self.response(normal, normal);
            self.impulses[normal] = unbounded.max(0.0);
            let scale = 1.0 / (self.response(one, one) + self.response(two, two));
            let along = |row: usize| self.impulses[row] - scale * self.velocity(row);
            let across = Vector2::new(along(one), along(two));
            let across = across.cap_magnitude(self.friction[contact] * self.impulses[normal]);
            (self.impulses[one], self.impulses[two]) = (across.x, across.y);
        }
    }
}

/// Solves linear equations in place by elimination with row pivoting: each has `count` coefficients and the
/// right-hand side, which becomes the solution. Returns `false` if there is no finite one.
fn eliminate(equations: &mut [f64], count: usize) -> bool {
    let width = count + 1;
    for step in 0..count {
        let size = |row: usize| equations[row * width + step].abs();
        let pivot = (step..count).fold(step, |best, row| if size(row) > size(best) { row } else { best });
        if pivot != step {
            let (upper, lower) = equations.split_at_mut(pivot * width);
            upper[step * width..][..width].swap_with_slice(&mut lower[..width]);
        }
        let (upper, lower) = equations.split_at_mut((step + 1) * width);
        let row = &upper[step * width..][step..];
        let inverse = 1.0 / row[0];
        for other in lower.chunks_exact_mut(width) {
            let factor = other[step] * inverse;
            if factor != 0.0 {
                other[step..].iter_mut().zip(row).for_each(|(value, own)| *value -= factor * own);
            }
        }
    }
    for step in (0..count).rev() {
        let (upper, lower) = equations.split_at_mut((step + 1) * width);
        let row = &mut upper[step * width..];
        let known =
            lower.chunks_exact(width).zip(&row[step + 1..count]).map(|(other, own)| own * other[count]);
        let solution = (row[count] - known.sum::<f64>()) / row[step];
        if !solution.is_finite() {
            return false;
        }
        row[count] = solution;
    }
    true
}

#[cfg(test)]
mod tests {
    use tesaki_rng::Rng;

    use super::*;

    /// Checks the conditions at the top of this file, without the projections, to a velocity of 1e-7.
    fn check(constraints: &Constraints) {
        const NONE: f64 = 1e-7;
        for row in &constraints.rows[..constraints.joints] {
            let [lower, upper] = row.bounds;
            assert!(row.impulse >= lower && row.impulse <= upper);
            assert!(row.velocity <= NONE || row.impulse <= lower + 1e-9, "{}", row.velocity);
            assert!(row.velocity >= -NONE || row.impulse >= upper - 1e-9, "{}", row.velocity);
        }
        for ([normal, one, two], friction) in constraints.contacts().zip(&constraints.friction) {
            assert!(normal.impulse >= 0.0 && normal.velocity >= -NONE);
            assert!(normal.velocity <= NONE || normal.impulse <= 1e-9);
            let across = Vector2::new(one.impulse, two.impulse);
            let slip = Vector2::new(one.velocity, two.velocity);
            let limit = friction * normal.impulse;
            assert!(across.norm() <= limit * (1.0 + 1e-6) + 1e-9);
            if slip.norm() > 1e-4 && limit > 1e-4 {
                assert!((across / limit + slip.normalize()).norm() < 1e-3, "{across} {slip} {limit}");
            }
        }
    }

    /// Rows of a random machine: `joints` of one chain, and contacts of their links with an object.
    fn machine(rng: &mut Rng, joints: usize, contacts: usize) -> (Constraints, Vec<f32>, [Vector3<f64>; 2]) {
        let mut vector = || Vector3::from_fn(|_, _| rng.symmetric());
        let object = [vector(), vector()];
        let places: Vec<_> = (0..contacts).map(|_| (vector(), vector().normalize())).collect();
        let inertia: Vec<f64> = (0..joints).map(|_| 1.5 + rng.symmetric()).collect();
        let row = |links: Vec<f64>| {
            let links_response = links.iter().zip(&inertia).map(|(link, inertia)| link / inertia).collect();
            Row { links, links_response, ..Row::default() }
        };
        let unit = |joint: usize| (0..joints).map(|other| if other == joint { 1.0 } else { 0.0 }).collect();
        let mut constraints = Constraints::default();
        constraints.begin((0..joints).map(|joint| Row { bounds: [-0.3, 0.3], ..row(unit(joint)) }).collect());
        for (place, normal) in places {
            let one = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
            let rows = [normal, one, normal.cross(&one)].map(|direction| {
                let turn = place.cross(&direction);
                Row {
                    object: Some(ObjectRow {
                        linear: -direction,
                        angular: -turn,
                        linear_response: -direction * 2.0,
                        angular_response: -turn * 3.0,
                    }),
                    ..row((0..joints).map(|_| rng.symmetric()).collect())
                }
            });
            constraints.add_contact(rows, 0.5 + 0.4 * rng.symmetric(), (0.0, 0.1));
        }
        let velocities = (0..joints).map(|_| rng.symmetric() as f32).collect();
        (constraints, velocities, object)
    }

    #[test]
    fn the_impulses_meet_all_conditions() {
        let (mut solved, mut slides, mut sticks) = (0, 0, 0);
        for seed in 0..500 {
            let mut rng = Rng::new(seed, 0);
            let (mut constraints, velocities, object) =
                machine(&mut rng, 3 + (seed as usize) % 7, 1 + (seed as usize) % 5);
            if constraints.solve(|row| row.of(&velocities, &object)) {
                check(&constraints);
                solved += 1;
            }
            for [_, one, _] in constraints.contacts().filter(|[normal, ..]| normal.impulse > 1e-6) {
                if one.velocity.abs() > 1e-6 { slides += 1 } else { sticks += 1 }
            }
        }
        assert!(solved >= 495 && slides > 100 && sticks > 50, "{solved} {slides} {sticks}");
    }

    /// A sphere of unit mass and radius on a plane: it falls with 1 m/s and slips with 2 m/s at the contact.
    fn landing(friction: f64) -> [f64; 2] {
        let rows = [Vector3::z(), Vector3::x(), Vector3::y()].map(|direction| {
            let turn = Vector3::new(0.0, 0.0, -1.0).cross(&direction);
            Row {
                object: Some(ObjectRow {
                    linear: direction,
                    angular: turn,
                    linear_response: direction,
                    angular_response: turn * 2.5,
                }),
                ..Row::default()
            }
        });
        let mut constraints = Constraints::default();
        constraints.begin(Vec::new());
        constraints.add_contact(rows, friction, (0.0, 0.0));
        let object = [Vector3::new(2.0, 0.0, -1.0), Vector3::zeros()];
        assert!(constraints.solve(|row| row.of(&[], &object)));
        let [[normal, one, _]] = constraints.contacts().collect::<Vec<_>>()[..] else { panic!() };
        assert!((normal.impulse - 1.0).abs() < 1e-7);
        [one.impulse, one.velocity]
    }

    /// By hand: an impulse J changes the slip velocity by 3.5 J, so that 2 m/s end with 4/7.
    #[test]
    fn a_ball_slides_or_rolls() {
        let near = |[a, b]: [f64; 2], [c, d]: [f64; 2]| (a - c).abs() < 1e-6 && (b - d).abs() < 1e-6;
        assert!(near(landing(0.4), [-0.4, 0.6]), "{:?}", landing(0.4));
        assert!(near(landing(0.6), [-4.0 / 7.0, 0.0]), "{:?}", landing(0.6));
    }

    #[test]
    fn nothing_to_solve_is_solved_and_no_number_is_not() {
        let mut constraints = Constraints::default();
        constraints.begin(Vec::new());
        assert!(constraints.solve(|_| 0.0));
        let (mut constraints, ..) = machine(&mut Rng::new(1, 0), 3, 1);
        assert!(!constraints.solve(|_| f64::NAN));
        assert!(constraints.rows().iter().all(|row| row.impulse == 0.0));
    }
}
