use heapless::Vec;
use nalgebra::{Matrix3, Vector3, Vector6};

use crate::kinematics::{Chain, Link};
use crate::math;
use crate::model::MAX_CHAIN_JOINTS;

/// Results of the outward pass.
#[derive(Clone, Copy)]
struct Pass {
    sine: f32,
    cosine: f32,
    force: Vector3<f32>,
    moment: Vector3<f32>,
}

impl Chain {
    /// Inverse dynamics by the recursive Newton–Euler algorithm (Luh, Walker and Paul 1980): the joint
    /// torques [N·m] that give the accelerations `qdd` [rad/s²] at angles `q` [rad] and velocities
    /// `qd` [rad/s] under `gravity` [m/s², base frame].
    ///
    /// The slices hold one value per joint, base to tip; the shortest determines how many joints are
    /// computed. For a tilted base, pass `gravity` in its frame. Rotor inertia is included if the chain has
    /// it ([`Chain::with_rotor_inertia`]); friction is added by
    /// [`FrictionFeedforward`](crate::control::FrictionFeedforward).
    pub fn inverse_dynamics(
        &self,
        gravity: &Vector3<f32>,
        q: &[f32],
        qd: &[f32],
        qdd: &[f32],
        torques: &mut [f32],
    ) {
        self.newton_euler(gravity, None, q, qd, qdd, torques);
    }

    /// [`Chain::inverse_dynamics`] with an external wrench on the tip: force [N] and moment [N·m] about the
    /// tip's origin in base axes. A wrench that the *tip* exerts has the opposite sign.
    ///
    /// Ignored unless all joints of the chain are computed.
    ///
    /// ```
    /// # use nalgebra::{Vector3, Vector6};
    /// # use tesaki::{kinematics::Chain, model::{Inertial, Pose}};
    /// // A massless link that reaches 0.5 m along x from a vertical axis, pushed along y with 10 N.
    /// let link = Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] };
    /// let tip = Pose { translation: [0.5, 0.0, 0.0], ..Pose::IDENTITY };
    /// let chain = Chain::from_links([(&Pose::IDENTITY, &[0.0, 0.0, 1.0], &link)], &tip)?;
    /// let (push, mut torque) = (Vector6::new(0.0, 10.0, 0.0, 0.0, 0.0, 0.0), [0.0]);
    /// chain.inverse_dynamics_with_wrench(&Vector3::zeros(), &push, &[0.0], &[0.0], &[0.0], &mut torque);
    /// assert_eq!(torque, [-5.0]); // the joint pushes back
    /// # Ok::<(), tesaki::kinematics::InvalidChain>(())
    /// ```
    pub fn inverse_dynamics_with_wrench(
        &self,
        gravity: &Vector3<f32>,
        wrench: &Vector6<f32>,
        q: &[f32],
        qd: &[f32],
        qdd: &[f32],
        torques: &mut [f32],
    ) {
        self.newton_euler(gravity, Some(wrench), q, qd, qdd, torques);
    }

    /// Always inlined, so that the version without a wrench contains none of its code.
    #[inline(always)]
    fn newton_euler(
        &self,
        gravity: &Vector3<f32>,
        wrench: Option<&Vector6<f32>>,
        q: &[f32],
        qd: &[f32],
        qdd: &[f32],
        torques: &mut [f32],
    ) {
        let zero = Vector3::zeros();
        let mut passes = Vec::<Pass, MAX_CHAIN_JOINTS>::new();

        // Outward pass: angular velocity and acceleration, and the acceleration of the origin, of each link
        // in its own frame. Gravity enters as upward acceleration of the base.
        let (mut omega, mut alpha, mut acceleration) = (zero, zero, -gravity);
        // The tip's wrench is rotated to each link's frame.
        let mut wrench = wrench.map(|wrench| math::halves(wrench).into());
        let mut joints = self.links.iter().zip(q).zip(qd).zip(qdd);
        if let Some((((link, &q), &qd), &qdd)) = joints.next() {
            let mut pass = Pass::at(q);
            wrench = wrench.map(|wrench| pass.wrench_from_parent(&link.rotation, &wrench));
            acceleration = pass.link_from_parent(&link.rotation, &acceleration);
            (omega.z, alpha.z) = (qd, qdd);
            pass.first_link(link, &acceleration, qd, qdd);
            // Cannot fail: the vector has room for every link.
            let _ = passes.push(pass);
        }
        for (((link, &q), &qd), &qdd) in joints {
            let mut pass = Pass::at(q);
            wrench = wrench.map(|wrench| pass.wrench_from_parent(&link.rotation, &wrench));
            acceleration += alpha.cross(&link.translation) + centripetal(&omega, &link.translation);
            acceleration = pass.link_from_parent(&link.rotation, &acceleration);
            omega = pass.link_from_parent(&link.rotation, &omega);
            alpha = pass.link_from_parent(&link.rotation, &alpha);
            // ω̇ = ω̇_parent + ω × z q̇ + z q̈, with ω before the joint's own velocity is added.
            alpha += Vector3::new(omega.y * qd, -omega.x * qd, qdd);
            omega.z += qd;
            pass.link(link, &acceleration, &omega, &alpha);
            let _ = passes.push(pass);
        }
        let tip_wrench = wrench.filter(|_| passes.len().min(torques.len()) == self.links.len());
        self.inward(&mut passes, tip_wrench, qdd, torques);
    }

    /// The inward pass: forces and moments from the tip to the base; a joint's torque is the component of the
    /// moment along its axis. `wrench` is in the axes of the last link.
    #[inline(always)]
    fn inward(
        &self,
        passes: &mut Vec<Pass, MAX_CHAIN_JOINTS>,
        wrench: Option<(Vector3<f32>, Vector3<f32>)>,
        qdd: &[f32],
        torques: &mut [f32],
    ) {
        let count = passes.len().min(torques.len());
        if let (Some((force, moment)), Some(last)) = (wrench, passes.last_mut()) {
            last.force -= force;
            last.moment -= moment + self.tip.translation.vector.cross(&force);
        }
        let mut joints = self.links.iter().zip(&*passes).zip(&mut *torques).take(count);
        let first = joints.next();
        let mut child: Option<(&Link, &Pass, Vector3<f32>, Vector3<f32>)> = None;
        for ((link, pass), torque) in joints.rev() {
            let (mut force, mut moment) = (pass.force, pass.moment);
            if let Some((link, pass, child_force, child_moment)) = child {
                let (transmitted, turned) = pass.transmit(link, &child_force, &child_moment);
                force += transmitted;
                moment += turned;
            }
            *torque = moment.z;
            child = Some((link, pass, force, moment));
        }
        // At the base only the moment about the axis is needed; the compiler removes the rest.
        if let Some(((_, pass), torque)) = first {
            let transmitted =
                |(link, pass, force, moment): (&Link, &Pass, _, _)| pass.transmit(link, &force, &moment);
            *torque = pass.moment.z + child.map_or(0.0, |child| transmitted(child).1.z);
        }
        for ((torque, inertia), qdd) in torques.iter_mut().zip(&self.rotor_inertia).zip(qdd).take(count) {
            *torque += inertia * qdd;
        }
    }
}

/// `ω × (ω × r)`.
#[inline]
fn centripetal(omega: &Vector3<f32>, r: &Vector3<f32>) -> Vector3<f32> {
    omega.cross(&omega.cross(r))
}

impl Pass {
    /// Of a joint at the angle `q` [rad], without force and moment.
    #[inline(always)]
    fn at(q: f32) -> Self {
        let (sine, cosine) = math::sin_cos(q);
        Self { sine, cosine, force: Vector3::zeros(), moment: Vector3::zeros() }
    }

    /// Inertial force and moment of the first link, which rotates about its own z axis only.
    #[inline(always)]
    fn first_link(&mut self, link: &Link, acceleration: &Vector3<f32>, qd: f32, qdd: f32) {
        let (center, column) = (&link.center_of_mass, link.inertia.column(2));
        let centripetal = -qd * qd;
        let of_center = Vector3::new(
            centripetal * center.x - qdd * center.y,
            centripetal * center.y + qdd * center.x,
            0.0,
        );
        self.force = (acceleration + of_center) * link.mass;
        let gyroscopic = Vector3::new(centripetal * column.y, -centripetal * column.x, 0.0);
        self.moment = column * qdd + gyroscopic + center.cross(&self.force);
    }

    /// Inertial force and moment of a link from the acceleration of its origin, its angular velocity and
    /// acceleration.
    #[inline(always)]
    fn link(&mut self, link: &Link, acceleration: &Vector3<f32>, omega: &Vector3<f32>, alpha: &Vector3<f32>) {
        let center =
            acceleration + alpha.cross(&link.center_of_mass) + centripetal(omega, &link.center_of_mass);
        self.force = center * link.mass;
        self.moment = link.inertia * alpha
            + omega.cross(&(link.inertia * omega))
            + link.center_of_mass.cross(&self.force);
    }

    /// A vector of the parent link's frame in this link's frame.
    #[inline]
    fn link_from_parent(&self, rotation: &Matrix3<f32>, v: &Vector3<f32>) -> Vector3<f32> {
        let v = rotation.tr_mul(v);
        Vector3::new(self.cosine * v.x + self.sine * v.y, self.cosine * v.y - self.sine * v.x, v.z)
    }

    /// The force and the moment of a wrench, likewise.
    #[inline(always)]
    fn wrench_from_parent(
        &self,
        rotation: &Matrix3<f32>,
        (force, moment): &(Vector3<f32>, Vector3<f32>),
    ) -> (Vector3<f32>, Vector3<f32>) {
        (self.link_from_parent(rotation, force), self.link_from_parent(rotation, moment))
    }

    /// A vector of this link's frame in the parent link's frame.
    #[inline]
    fn parent_from_link(&self, rotation: &Matrix3<f32>, v: &Vector3<f32>) -> Vector3<f32> {
        rotation * Vector3::new(self.cosine * v.x - self.sine * v.y, self.sine * v.x + self.cosine * v.y, v.z)
    }

    /// Force and moment of this link on the parent link, about the parent's joint.
    #[inline(always)]
    fn transmit(
        &self,
        link: &Link,
        force: &Vector3<f32>,
        moment: &Vector3<f32>,
    ) -> (Vector3<f32>, Vector3<f32>) {
        let force = self.parent_from_link(&link.rotation, force);
        (force, self.parent_from_link(&link.rotation, moment) + link.translation.cross(&force))
    }
}
