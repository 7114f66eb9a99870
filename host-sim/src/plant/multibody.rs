//! Links, integrated exactly as rapier does, to the last bit without contacts.
//!
//! Rapier's multibodies support joints of any kind and matrices of any size, and each of its steps looks for
//! contacts, islands and soft bodies. A robot that touches nothing needs none of that. This module has the
//! remaining parts of a step: the semi-implicit equations of motion, the projected Gauss–Seidel sweeps over
//! dry friction and end stops, and the integration of the angles. Each sum has rapier's terms in rapier's
//! order, except those that are zero for every motion: columns of joints that do not move a link, elements of
//! diagonal matrices, stops that are not reached. The tests compare it with rapier bit by bit.

use rapier3d::dynamics::{
    JointAxis, RigidBodyHandle, RigidBodyMassProps, RigidBodySet, RigidBodyType, SpringCoefficients,
};
use rapier3d::math::{AngularInertia, Matrix, Pose, Rotation, Vector};
use rapier3d::na::{Matrix3, Vector3};

use super::constraints;
use super::convert::{narrow, wide};
use super::lu::{Lu, add_scaled, dot};

/// If a joint turns farther than this in a sub-step [rad], the energy that an implicit step adds is checked.
const FAST: f32 = 1e-3;

/// Sweeps over the constraints in a sub-step. Dry friction in the joints of a chain is coupled: with too few
/// sweeps, joints that should be at rest creep.
pub const SWEEPS: usize = 8;

/// The links that are moved by one joint of the base.
pub struct Multibody {
    root: Place,
    links: Vec<Link>,
    /// Joint axes, in the frame of the base.
    axes: Vec<Vector>,
    velocities: Vec<f32>,
    accelerations: Vec<f32>,
    /// Generalised forces, and the part of them that is applied externally.
    forces: [Vec<f32>; 2],
    /// Mass matrix, and the same with the terms that Coriolis forces and damping add at the end of a
    /// sub-step.
    mass: Lu,
    implicit: Lu,
    rows: Vec<JointRow>,
    /// For each row, the response of the joint velocities to a unit impulse.
    responses: Vec<f32>,
    workspace: Vec<f32>,
    /// Impulses of the joints' dry friction in the last sub-step, if contacts are among the constraints.
    frictions: Vec<f64>,
}

/// A link and the joint before it.
struct Link {
    body: RigidBodyHandle,
    parent: Option<usize>,
    /// The joints from the base to its own, which is the last.
    path: Vec<usize>,
    /// Frames of the joint relative to the links before and behind it; the latter inverted.
    frames: [Pose; 2],
    /// Origin of the second frame.
    joint: Vector,
    stops: Option<[f32; 2]>,
    damping: f32,
    armature: f32,
    friction: f32,
    softness: SpringCoefficients<f32>,
    properties: RigidBodyMassProps,
    /// About the centre of mass, in the axes of the base.
    inertia: AngularInertia,
    angle: f32,
    turn: Rotation,
    place: Place,
    /// Orientation of the joint frame.
    joint_turn: Rotation,
    /// From the centre of mass of the previous link to the joint, and from there to that of this link.
    shifts: [Vector; 2],
    /// Column of the linear Jacobian of the centre of mass, for each joint of the path.
    linear: Vec<Vector>,
    /// Change of linear and angular velocity of the centre of mass for each joint of the path.
    coriolis: Vec<[Vector; 2]>,
    spin: Vector,
    joint_spin: Vector,
    /// Linear and angular acceleration, without the contribution of the joint accelerations.
    acceleration: [Vector; 2],
    force: Vector,
    torque: Vector,
}

/// Pose of a link, and its centre of mass, in the frame of the base.
#[derive(Clone, Copy)]
struct Place {
    pose: Pose,
    center: Vector,
}

/// A constraint on the velocity of one joint.
struct JointRow {
    joint: usize,
    impulse: f32,
    bounds: [f32; 2],
    /// Inverse of the velocity response to a unit impulse.
    gain: f32,
    bias: f32,
    compliance: f32,
}

impl Multibody {
    /// Copies a multibody of rapier.
    pub fn new(chain: &rapier3d::dynamics::Multibody, bodies: &RigidBodySet) -> Self {
        let place = |body: RigidBodyHandle, pose: &Pose| {
            let center = *pose * bodies[body].mass_properties().local_mprops.local_com;
            Place { pose: *pose, center }
        };
        let root = chain.root();
        let root = place(root.rigid_body_handle(), root.local_to_world());
        let mut links: Vec<Link> = Vec::new();
        for (index, link) in chain.links().skip(1).enumerate() {
            let (body, data) = (link.rigid_body_handle(), &link.joint.data);
            let parent = link.parent_id().and_then(|parent| parent.checked_sub(1));
            let mut path = parent.map_or(Vec::new(), |parent| links[parent].path.clone());
            path.push(index);
            let stops = data.limits(JointAxis::AngX).map(|limits| [limits.min, limits.max]);
            links.push(Link {
                body,
                parent,
                frames: [data.local_frame1, data.local_frame2.inverse()],
                joint: data.local_frame2.translation,
                stops,
                damping: chain.damping()[index],
                armature: chain.armature()[index],
                friction: chain.frictions()[index],
                softness: data.softness,
                properties: bodies[body].mass_properties().clone(),
                inertia: AngularInertia::zero(),
                angle: link.joint.coords()[3],
                turn: link.joint.joint_rot(),
                place: place(body, link.local_to_world()),
                joint_turn: Rotation::IDENTITY,
                shifts: [Vector::ZERO; 2],
                linear: vec![Vector::ZERO; path.len()],
                coriolis: vec![[Vector::ZERO; 2]; path.len()],
                spin: Vector::ZERO,
                joint_spin: Vector::ZERO,
                acceleration: [Vector::ZERO; 2],
                force: Vector::ZERO,
                torque: Vector::ZERO,
                path,
            });
        }
        let size = links.len();
        let zeros = || vec![0.0; size];
        let mut multibody = Self {
            root,
            links,
            axes: vec![Vector::ZERO; size],
            velocities: chain.generalized_velocity().iter().copied().collect(),
            accelerations: zeros(),
            forces: [zeros(), zeros()],
            mass: Lu::new(size),
            implicit: Lu::new(size),
            rows: Vec::with_capacity(2 * size),
            responses: Vec::with_capacity(2 * size * size),
            workspace: zeros(),
            frictions: vec![0.0; size],
        };
        multibody.place_links();
        multibody
    }

    /// The bodies of its links, in order.
    pub fn bodies(&self) -> impl Iterator<Item = RigidBodyHandle> {
        self.links.iter().map(|link| link.body)
    }

    /// Pose of a link in the frame of the base.
    pub fn pose(&self, link: usize) -> &Pose {
        &self.links[link].place.pose
    }

    /// Angle [rad] of the joint before a link, and its velocity in the last sub-step [rad/s].
    pub fn motion(&self, link: usize) -> (f32, f32) {
        (self.links[link].angle, self.velocities[link])
    }

    /// Coulomb friction of the joint before a link [N·m].
    pub fn friction(&self, link: usize) -> f32 {
        self.links[link].friction
    }

    /// Clears all forces and torques.
    pub fn release(&mut self) {
        for link in &mut self.links {
            (link.force, link.torque) = (Vector::ZERO, Vector::ZERO);
        }
    }

    /// Adds a torque on a link for the next sub-step [N·m].
    pub fn add_torque(&mut self, link: usize, torque: Vector) {
        self.links[link].torque += torque;
    }

    /// Adds a torque between a link and the one before it [N·m].
    pub fn add_joint_torque(&mut self, link: usize, torque: Vector) {
        self.add_torque(link, torque);
        if let Some(parent) = self.links[link].parent {
            self.add_torque(parent, -torque);
        }
    }

    /// Adds a force on a point of a link for the next sub-step [N], in the frame of the base.
    pub fn add_force(&mut self, link: usize, force: Vector, point: Vector) {
        let link = &mut self.links[link];
        link.force += force;
        link.torque += (point - link.place.center).cross(force);
    }

    /// Advances by one sub-step.
    pub fn step(&mut self, gravity: Vector, dt: f32) {
        self.accelerate(gravity, dt);
        self.constrain(dt);
        self.advance(dt);
    }

    /// Changes the velocities by those of a sub-step, without constraints.
    pub fn accelerate(&mut self, gravity: Vector, dt: f32) {
        self.turn_links();
        self.fill_masses(dt);
        self.mass.factorise();
        self.implicit.factorise();
        self.find_accelerations(gravity, dt);
        for (velocity, acceleration) in self.velocities.iter_mut().zip(&self.accelerations) {
            *velocity += dt * acceleration;
        }
    }

    /// Moves the links with their velocities.
    pub fn advance(&mut self, dt: f32) {
        for (link, velocity) in self.links.iter_mut().zip(&self.velocities) {
            link.angle += velocity * dt;
            link.turn = Rotation::from_axis_angle(Vector::X, link.angle);
        }
        self.place_links();
    }

    /// Joint velocities [rad/s].
    pub fn velocities(&self) -> &[f32] {
        &self.velocities
    }

    /// Changes the velocities by the impulses of `rows`, of which the first are the constraints of the
    /// joints.
    pub fn take_impulses<'a>(&mut self, rows: impl Iterator<Item = &'a constraints::Row>) {
        let mut velocities: Vec<f64> = self.velocities.iter().copied().map(f64::from).collect();
        for (index, row) in rows.enumerate() {
            for (velocity, response) in velocities.iter_mut().zip(&row.links_response) {
                *velocity += response * row.impulse;
            }
            if let Some(JointRow { joint, .. }) = self.rows.get(index).filter(|row| row.is_friction()) {
                self.frictions[*joint] = row.impulse;
            }
        }
        self.velocities.iter_mut().zip(velocities).for_each(|(velocity, wide)| *velocity = narrow(wide));
    }

    /// The constraints of the joints.
    pub fn constraints(&mut self, dt: f32) -> impl Iterator<Item = constraints::Row> {
        self.prepare_rows(dt);
        let (size, frictions) = (self.links.len(), &self.frictions);
        self.rows.iter().zip(self.responses.chunks_exact(size)).map(move |(row, response)| {
            let mut links = vec![0.0; size];
            links[row.joint] = 1.0;
            // Here, impulses have the opposite sign.
            let [lower, upper] = row.bounds.map(f64::from);
            constraints::Row {
                links,
                links_response: response.iter().copied().map(f64::from).collect(),
                bias: row.bias.into(),
                compliance: row.compliance.into(),
                bounds: [-upper, -lower],
                impulse: if row.is_friction() { frictions[row.joint] } else { 0.0 },
                ..constraints::Row::default()
            }
        })
    }

    /// The velocity of a point of a link along a direction, as a constraint.
    pub fn row(&self, link: usize, point: &Vector3<f64>, direction: &Vector3<f64>) -> constraints::Row {
        let link = &self.links[link];
        let lever = point - wide(link.place.center);
        let mut links = vec![0.0; self.links.len()];
        let mut response = vec![0.0; self.links.len()];
        for (joint, linear) in link.path.iter().zip(&link.linear) {
            let motion = wide(*linear) + wide(self.axes[*joint]).cross(&lever);
            links[*joint] = motion.dot(direction);
            response[*joint] = narrow(links[*joint]);
        }
        self.mass.solve(&mut response);
        let links_response = response.into_iter().map(f64::from).collect();
        constraints::Row { links, links_response, ..constraints::Row::default() }
    }

    /// Computes the forward kinematics.
    fn place_links(&mut self) {
        for index in 0..self.links.len() {
            let (before, link) = split(&mut self.links, index);
            let parent = link.parent.map(|parent| &before[parent]);
            let Place { pose, center } = parent.map_or(self.root, |parent| parent.place);
            let [first, second] = link.frames;
            let own = pose * (first * (Pose::from_rotation(link.turn) * second));
            let joint = own * link.joint;
            link.place = Place { pose: own, center: own * link.properties.local_mprops.local_com };
            link.shifts = [joint - center, link.place.center - joint];
            link.properties.update_world_mass_properties(RigidBodyType::Dynamic, &own);
            link.inertia = link.properties.effective_angular_inertia();
            link.joint_turn = pose.rotation * first.rotation;
            self.axes[index] = Matrix::from_quat(link.joint_turn).x_axis;
            let before = parent.map_or(&[][..], |parent| &parent.linear);
            let [to_joint, to_center] = link.shifts;
            for (order, (linear, joint)) in link.linear.iter_mut().zip(&link.path).enumerate() {
                let axis = self.axes[*joint];
                let of_joint = before.get(order).map_or(Vector::ZERO, |v| carried(*v, to_joint, axis));
                *linear = carried(of_joint, to_center, axis);
            }
        }
    }

    /// Computes the angular velocities.
    fn turn_links(&mut self) {
        for index in 0..self.links.len() {
            let velocity = self.velocities[index];
            let (before, link) = split(&mut self.links, index);
            let parent = link.parent.map_or(Vector::ZERO, |parent| before[parent].spin);
            link.joint_spin = link.joint_turn * Vector::new(velocity, 0.0, 0.0);
            link.spin = parent + link.joint_spin;
        }
    }

    fn fill_masses(&mut self, dt: f32) {
        self.mass.matrix_mut().fill(0.0);
        self.implicit.matrix_mut().fill(0.0);
        let size = self.links.len();
        for index in 0..size {
            let (before, link) = split(&mut self.links, index);
            link.fill_coriolis(link.parent.map(|parent| &before[parent]), &self.axes);
            let link = &*link;
            let (mass, inertia) = (link.properties.effective_mass(), matrix(link.inertia));
            let gyroscopic = cross(link.spin) * inertia - cross(inertia * link.spin);
            let (mass_dt, inertia_dt, turning) = (mass * dt, inertia * dt, inertia + gyroscopic * dt);
            for ((column, linear), coriolis) in link.path.iter().zip(&link.linear).zip(&link.coriolis) {
                let axis = self.axes[*column];
                let momentum = (mass * *linear, inertia * axis, turning * axis);
                let coriolis = [coriolis[0] * mass_dt, inertia_dt * coriolis[1]];
                let range = column * size..(column + 1) * size;
                let plain = &mut self.mass.matrix_mut()[range.clone()];
                let implicit = &mut self.implicit.matrix_mut()[range];
                for (row, linear) in link.path.iter().zip(&link.linear) {
                    let axis = self.axes[*row];
                    let of_mass = dot3(*linear, momentum.0);
                    plain[*row] += on(of_mass, axis, momentum.1);
                    implicit[*row] += on(of_mass, axis, momentum.2);
                    implicit[*row] += on(dot3(*linear, coriolis[0]), axis, coriolis[1]);
                }
            }
        }
        for (index, link) in self.links.iter().enumerate() {
            let diagonal = link.damping * dt + link.armature;
            self.mass.matrix_mut()[index * (size + 1)] += diagonal;
            self.implicit.matrix_mut()[index * (size + 1)] += diagonal;
        }
    }

    fn find_accelerations(&mut self, gravity: Vector, dt: f32) {
        let is_fast = dt * self.velocities.iter().fold(0.0, |most: f32, v| most.max(v.abs())) >= FAST;
        let [forces, applied] = &mut self.forces;
        forces.fill(0.0);
        applied.fill(0.0);
        for index in 0..self.links.len() {
            let (before, link) = split(&mut self.links, index);
            link.find_acceleration(link.parent.map(|parent| &before[parent]));
            let (mass, inertia) = (link.properties.effective_mass(), link.inertia);
            let force = link.force + gravity * mass;
            let gyroscopic = link.spin.cross(inertia * link.spin);
            let [linear, angular] = link.acceleration;
            let acting = (force - mass * linear, link.torque - gyroscopic - inertia * angular);
            for (joint, linear) in link.path.iter().zip(&link.linear) {
                let axis = self.axes[*joint];
                forces[*joint] += on(dot3(*linear, acting.0), axis, acting.1);
                if is_fast {
                    applied[*joint] += on(dot3(*linear, force), axis, link.torque);
                }
            }
        }
        for ((force, link), velocity) in forces.iter_mut().zip(&self.links).zip(&self.velocities) {
            *force -= link.damping * velocity;
        }
        self.accelerations.copy_from_slice(forces);
        self.implicit.solve(&mut self.accelerations);
        if is_fast && self.gains_energy(dt) {
            self.accelerations.copy_from_slice(&self.forces[0]);
            self.mass.solve(&mut self.accelerations);
            if !self.accelerations.iter().all(|value| value.is_finite()) {
                self.accelerations.fill(0.0);
            }
        }
    }

    /// Returns whether the accelerations add more energy than the forces' work plus 1 % of the kinetic
    /// energy.
    fn gains_energy(&mut self, dt: f32) -> bool {
        let [forces, applied] = &self.forces;
        let (velocities, accelerations, product) =
            (&self.velocities, &self.accelerations, &mut self.workspace);
        if !accelerations.iter().all(|value| value.is_finite()) {
            return true;
        }
        multiply(&self.mass, accelerations, product);
        let gained = dt * dot(velocities, product) + 0.5 * dt * dt * dot(accelerations, product);
        let work = dt * dot(velocities, forces) + 0.5 * dt * dt * dot(accelerations, applied);
        multiply(&self.mass, velocities, product);
        let kinetic = 0.5 * dot(velocities, product);
        let excess = gained - work - (1.0e-2 * kinetic + 1.0e-8);
        excess.is_nan() || excess > 0.0
    }

    /// Prepares the rows of dry friction and end stops.
    fn prepare_rows(&mut self, dt: f32) {
        let size = self.links.len();
        self.rows.clear();
        self.responses.clear();
        for (joint, link) in self.links.iter().enumerate() {
            let (stop, friction) = (link.stop(dt), link.friction * dt);
            let friction = (friction > 0.0).then_some((0.0, [-friction, friction]));
            for (bias, bounds) in stop.into_iter().chain(friction) {
                let begin = self.responses.len();
                self.responses.resize(begin + size, 0.0);
                let response = &mut self.responses[begin..];
                response[joint] = 1.0;
                self.mass.solve(response);
                let compliance = response[joint] * link.softness.cfm_coeff(dt);
                let gain = inverse(response[joint] + compliance);
                self.rows.push(JointRow { joint, impulse: 0.0, bounds, gain, bias, compliance });
            }
        }
    }

    /// Applies dry friction and end stops.
    fn constrain(&mut self, dt: f32) {
        self.prepare_rows(dt);
        let size = self.links.len();
        let mut changes = true;
        for _ in 0..SWEEPS {
            // Once a sweep changes nothing, further sweeps change nothing either.
            if !std::mem::take(&mut changes) {
                break;
            }
            for (row, response) in self.rows.iter_mut().zip(self.responses.chunks_exact(size)) {
                let velocity = row.bias + self.velocities[row.joint];
                let unbounded = row.impulse + row.gain * (velocity - row.compliance * row.impulse);
                let impulse = unbounded.min(row.bounds[1]).max(row.bounds[0]);
                let change = impulse - row.impulse;
                if change != 0.0 {
                    row.impulse = impulse;
                    add_scaled(&mut self.velocities, -change, response);
                    changes = true;
                }
            }
        }
    }
}

impl JointRow {
    /// Whether it is dry friction, and no stop.
    fn is_friction(&self) -> bool {
        self.bounds[0] > f32::MIN && self.bounds[1] < f32::MAX
    }
}

impl Link {
    /// Returns bias and bounds of the stop that the joint has passed.
    fn stop(&self, dt: f32) -> Option<(f32, [f32; 2])> {
        let [lower, upper] = self.stops?;
        let (below, above) = (self.angle < lower, upper < self.angle);
        let beyond = (self.angle - upper).max(0.0) - (lower - self.angle).max(0.0);
        let bounds = [if below { -f32::MAX } else { 0.0 }, if above { f32::MAX } else { 0.0 }];
        (below || above).then(|| (beyond * self.softness.erp_inv_dt(dt), bounds))
    }

    fn fill_coriolis(&mut self, parent: Option<&Self>, axes: &[Vector]) {
        let [to_joint, to_center] = self.shifts;
        let parent_spin = parent.map_or(Vector::ZERO, |parent| parent.spin);
        let way = cross_matrix(parent_spin) * cross_matrix(to_joint).transpose();
        let own_way = cross_matrix(self.spin) * cross_matrix(to_center).transpose();
        let (rate, own_rate) = (self.spin.cross(to_joint), self.spin.cross(to_center));
        let before = parent.map_or(&[][..], |parent| &parent.coriolis);
        for (order, (coriolis, joint)) in self.coriolis.iter_mut().zip(&self.path).enumerate() {
            let axis = axes[*joint];
            let [linear, angular] = match before.get(order) {
                Some(&[linear, angular]) => {
                    let linear = carried(carried(linear, to_joint, angular), rate, axis);
                    [plus_product(linear, &way, axis), carried(angular, self.joint_spin, axis)]
                }
                None => [Vector::ZERO, parent_spin.cross(axis)],
            };
            let linear = carried(carried(linear, to_center, angular), own_rate, axis);
            *coriolis = [plus_product(linear, &own_way, axis), angular];
        }
    }

    fn find_acceleration(&mut self, parent: Option<&Self>) {
        let [to_joint, to_center] = self.shifts;
        let spin = parent.map_or(Vector::ZERO, |parent| parent.spin);
        let [mut linear, mut angular] = parent.map_or([Vector::ZERO; 2], |parent| parent.acceleration);
        let parent_angular = angular;
        angular += spin.cross(self.joint_spin);
        linear += spin.cross(spin.cross(to_joint));
        linear += parent_angular.cross(to_joint);
        linear += self.spin.cross(self.spin.cross(to_center));
        linear += angular.cross(to_center);
        self.acceleration = [linear, angular];
    }
}

/// Returns a link, and those before it.
fn split(links: &mut [Link], index: usize) -> (&[Link], &mut Link) {
    let (before, rest) = links.split_at_mut(index);
    (before, &mut rest[0])
}

/// Returns the velocity at `shift` from a point with the velocity `known`, on a body that turns at `turn`.
fn carried(known: Vector, shift: Vector, turn: Vector) -> Vector {
    Vector::new(
        known.x + shift.z * turn.y - shift.y * turn.z,
        known.y - shift.z * turn.x + shift.x * turn.z,
        known.z + shift.y * turn.x - shift.x * turn.y,
    )
}

fn matrix(inertia: AngularInertia) -> Matrix {
    let AngularInertia { m11, m12, m13, m22, m23, m33 } = inertia;
    Matrix::from_cols(Vector::new(m11, m12, m13), Vector::new(m12, m22, m23), Vector::new(m13, m23, m33))
}

fn cross(vector: Vector) -> Matrix {
    let Vector { x, y, z, .. } = vector;
    Matrix::from_cols(Vector::new(0.0, z, -y), Vector::new(-z, 0.0, x), Vector::new(y, -x, 0.0))
}

fn cross_matrix(vector: Vector) -> Matrix3<f32> {
    let Vector { x, y, z, .. } = vector;
    Matrix3::new(0.0, -z, y, z, 0.0, -x, -y, x, 0.0)
}

fn plus_product(sum: Vector, matrix: &Matrix3<f32>, vector: Vector) -> Vector {
    let row = |sum: f32, row: usize| {
        sum + matrix[(row, 0)] * vector.x + matrix[(row, 1)] * vector.y + matrix[(row, 2)] * vector.z
    };
    Vector::new(row(sum.x, 0), row(sum.y, 1), row(sum.z, 2))
}

fn dot3(one: Vector, other: Vector) -> f32 {
    one.x * other.x + one.y * other.y + one.z * other.z
}

/// Adds the scalar product of the angular parts to that of the linear parts.
fn on(linear: f32, one: Vector, other: Vector) -> f32 {
    linear + one.x * other.x + one.y * other.y + one.z * other.z
}

fn multiply(matrix: &Lu, vector: &[f32], product: &mut [f32]) {
    product.fill(0.0);
    for (column, value) in matrix.matrix().chunks_exact(vector.len()).zip(vector) {
        add_scaled(product, *value, column);
    }
}

/// Returns the inverse; 0 for a value that is practically 0.
fn inverse(value: f32) -> f32 {
    if value.abs() <= 1e-20 { 0.0 } else { 1.0 / value }
}
