use nalgebra::{SMatrix, Vector3, Vector6};

use super::*;
use crate::math::sqrt;

/// Reproducible pseudo-random numbers.
pub struct Random(pub u32);

impl Random {
    pub fn between(&mut self, lower: f32, upper: f32) -> f32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        lower + (upper - lower) * f32::from((self.0 >> 16) as u16) / 65_536.0
    }

    pub fn vector(&mut self, size: f32) -> Vector3<f32> {
        Vector3::from_fn(|_, _| self.between(-size, size))
    }

    /// Contacts on a sphere of 40 mm radius around `center`.
    pub fn ball(&mut self, count: usize, center: Vector3<f32>) -> GraspMap {
        let contacts: Vec<Contact> = (0..count)
            .map(|_| {
                let outward = self.vector(1.0).normalize();
                Contact::try_new(center + 0.04 * outward, -outward, 0.5, 20.0).unwrap()
            })
            .collect();
        GraspMap::try_new(&contacts, Vector3::zeros()).unwrap()
    }
}

pub fn contact(position: [f32; 3], normal: [f32; 3], friction: f32, limit: f32) -> Contact {
    Contact::try_new(position.into(), normal.into(), friction, limit).unwrap()
}

/// Fingers 1 and 2 at x = 0, 80 mm apart, finger 3 opposite their midpoint, with the object between them.
pub fn hand3_grasp(friction: f32) -> GraspMap {
    let contacts = [
        contact([0.0, 0.04, 0.0], [1.0, 0.0, 0.0], friction, 20.0),
        contact([0.0, -0.04, 0.0], [1.0, 0.0, 0.0], friction, 20.0),
        contact([0.06, 0.0, 0.0], [-1.0, 0.0, 0.0], friction, 20.0),
    ];
    GraspMap::try_new(&contacts, Vector3::zeros()).unwrap()
}

fn jacobian(random: &mut Random) -> crate::kinematics::Jacobian {
    SMatrix::from_fn(|_, column| if column < 3 { random.between(-0.1, 0.1) } else { 0.0 })
}

#[test]
fn forces_and_velocities_are_each_others_transpose() {
    let mut random = Random(1);
    for count in 2..=MAX_CONTACTS {
        let map = random.ball(count, Vector3::new(0.1, -0.2, 0.3));
        let forces: Vec<Vector3<f32>> = (0..count).map(|_| random.vector(3.0)).collect();
        let twist = Vector6::from_fn(|_, _| random.between(-1.0, 1.0));
        let wrench = map.wrench(&forces);
        let mut stacked = SMatrix::<f32, 18, 1>::zeros();
        for (index, force) in forces.iter().enumerate() {
            stacked.fixed_rows_mut::<3>(3 * index).copy_from(force);
        }
        assert!((map.matrix() * stacked - wrench).norm() < 1e-5);
        let velocities = map.velocities(&twist);
        let power: f32 = velocities.iter().zip(&forces).map(|(velocity, force)| velocity.dot(force)).sum();
        assert!((power - twist.dot(&wrench)).abs() < 1e-5);
    }
}

#[test]
fn the_papers_maps_agree_with_the_grasp_map() {
    let mut random = Random(2);
    let map = hand3_grasp(0.5);
    let levers = [0, 1, 2].map(|index| map.contacts()[index].position() - map.origin());

    let fingers = [(); 3].map(|()| (jacobian(&mut random), random.vector(0.01)));
    let hand = ThreeFingers::new(&fingers);
    for (block, (jacobian, lever)) in hand.blocks().iter().zip(&fingers) {
        let (linear, angular) = (jacobian.fixed_view::<3, 3>(0, 0), jacobian.fixed_view::<3, 3>(3, 0));
        assert!((block - (linear - lever.cross_matrix() * angular)).norm() < 1e-7);
    }
    // Virtual work: torques times joint velocities is forces times velocities of the contacts.
    let forces = [(); 3].map(|()| random.vector(2.0));
    let joints = [(); 3].map(|()| random.vector(1.0));
    let velocities_of =
        |joints: &[Vector3<f32>; 3]| [0, 1, 2].map(|finger| hand.blocks()[finger] * joints[finger]);
    let (torques, velocities) = (hand.torques(&forces), velocities_of(&joints));
    let power: f32 = (0..3).map(|finger| torques[finger].dot(&joints[finger])).sum();
    let expected: f32 = (0..3).map(|finger| forces[finger].dot(&velocities[finger])).sum();
    assert!((power - expected).abs() < 1e-6);
    // Joints that follow the object move the contacts with it.
    let twist = Vector6::new(0.01, -0.02, 0.03, 0.1, 0.2, -0.3);
    let followed = velocities_of(&hand.joint_velocities(&levers, &twist).unwrap());
    let expected = map.velocities(&twist);
    for finger in 0..3 {
        assert!((followed[finger] - expected[finger]).norm() < 1e-5);
    }
    // A singular finger: two joints with the same effect.
    let mut stretched = fingers;
    let column = stretched[1].0.column(1).into_owned();
    stretched[1].0.set_column(2, &column);
    let singular = ThreeFingers::new(&stretched).joint_velocities(&levers, &twist);
    assert_eq!(singular, Err(SingularFinger { finger: 1 }));
    stretched[1].0.fill(f32::NAN);
    let singular = ThreeFingers::new(&stretched).joint_velocities(&levers, &twist);
    assert_eq!(singular, Err(SingularFinger { finger: 1 }));
}

#[test]
fn the_pseudo_inverse_makes_the_wrench_with_forces_of_minimum_norm() {
    let mut random = Random(3);
    for round in 0..300 {
        let map = random.ball(2 + round % 5, random_center(round));
        let inverse = map.inverse();
        let report = *inverse.conditioning();
        // nalgebra's singular values of the map about the centroid, moments over the length.
        let mut scaled = SMatrix::<f64, 6, 18>::zeros();
        for (index, lever) in map.levers.iter().enumerate() {
            scaled.fixed_view_mut::<3, 3>(0, 3 * index).fill_with_identity();
            scaled.fixed_view_mut::<3, 3>(3, 3 * index).copy_from(&lever.cross_matrix().cast());
        }
        let exact = scaled.singular_values();
        assert!((f64::from(report.sigma_max) - exact.max()).abs() < 2e-6, "{report:?} {exact}");
        assert!(
            (f64::from(report.sigma_min) - exact.min()).abs() < 1e-3 * exact.min() + 5e-6,
            "{report:?} {exact}"
        );
        assert_eq!(report.rank, if map.contacts().len() == 2 { 5 } else { 6 });

        let made: Vec<Vector3<f32>> = map.contacts().iter().map(|_| random.vector(2.0)).collect();
        let wrench = map.wrench(&made);
        let forces = inverse.forces(&wrench).unwrap();
        let size = map.scaled(&wrench);
        let size = sqrt(size.0.norm_squared() + size.1.norm_squared());
        let residual = map.scaled(&(map.wrench(&forces) - wrench));
        assert!(
            sqrt(residual.0.norm_squared() + residual.1.norm_squared()) < 3e-6 * (size + 1.0),
            "{round} {residual:?} {size} {report:?}"
        );
        // Minimum norm: orthogonal to the internal forces.
        let mut internal = made.clone();
        internal.iter_mut().zip(&forces).for_each(|(made, force)| *made -= force);
        let dot: f32 = internal.iter().zip(&forces).map(|(a, b)| a.dot(b)).sum();
        assert!(dot.abs() < 2e-4, "{round}: {dot}");
    }
}

fn random_center(round: usize) -> Vector3<f32> {
    Vector3::new(0.001 * round as f32, -0.1, 0.2)
}

#[test]
fn an_equilateral_triangle_has_the_singular_values_worked_by_hand() {
    // Three contacts at unit distance (the length): moments in the plane have Σ sin² = 3/2, across it 3.
    let map = GraspMap::try_new(
        &[0.0_f32, 120.0, 240.0].map(|angle| {
            let (sine, cosine) = crate::math::sin_cos(angle.to_radians());
            contact([0.3 * cosine, 0.3 * sine, 0.0], [-cosine, -sine, 0.0], 0.5, 1.0)
        }),
        Vector3::zeros(),
    )
    .unwrap();
    let report = *map.inverse().conditioning();
    assert!((map.length() - 0.3).abs() < 1e-6);
    assert!((report.sigma_min - sqrt(1.5)).abs() < 1e-5 && (report.sigma_max - sqrt(3.0)).abs() < 1e-6);
    assert!((report.condition - sqrt(2.0)).abs() < 1e-5 && report.rank == 6 && report.axis.z.abs() < 1e-3);
}

#[test]
fn contacts_in_line_resist_no_moment_about_it() {
    let line: Vec<Contact> = [-1.0_f32, 0.2, 1.0]
        .iter()
        .map(|&x| contact([0.03 * x, 0.04 * x, 0.5], [0.0, 0.0, -1.0], 0.5, 10.0))
        .collect();
    let map = GraspMap::try_new(&line, Vector3::new(0.0, 0.0, 0.5)).unwrap();
    let inverse = map.inverse();
    let report = inverse.conditioning();
    assert!(report.rank == 5 && report.condition.is_infinite() && report.sigma_min < 1e-6);
    assert!((report.axis.x.abs() - 0.6).abs() < 1e-5 && (report.axis.y.abs() - 0.8).abs() < 1e-5);
    let about = Vector6::new(1.0, 2.0, 3.0, 0.06, 0.08, 0.0);
    let Err(WrenchInverseError::NotResisted { moment, .. }) = inverse.forces(&about) else { panic!() };
    assert!((moment.abs() - 0.1).abs() < 1e-6);
    let across = Vector6::new(1.0, 2.0, 3.0, -0.08, 0.06, 0.1);
    let forces = inverse.forces(&across).unwrap();
    assert!((map.wrench(&forces) - across).norm() < 1e-5);
    let nan = Vector6::new(f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0);
    assert_eq!(inverse.forces(&nan), Err(WrenchInverseError::NotFinite));
}

#[test]
fn contacts_without_a_grasp_map_are_refused_by_name() {
    let here = contact([0.1, 0.0, 0.0], [1.0, 0.0, 0.0], 0.5, 1.0);
    let there = contact([0.0, 0.1, 0.0], [1.0, 0.0, 0.0], 0.5, 1.0);
    let refused = |contacts: &[Contact]| GraspMap::try_new(contacts, Vector3::zeros()).unwrap_err();
    assert_eq!(refused(&[here]), GraspMapError::Contacts(1));
    assert_eq!(refused(&[here; 7]), GraspMapError::Contacts(7));
    assert_eq!(refused(&[here, here]), GraspMapError::Coincident { first: 0, second: 1, distance: 0.0 });
    let coincident = refused(&[there, here, here]);
    assert!(matches!(coincident, GraspMapError::Coincident { first: 1, second: 2, .. }));
    let nowhere = Vector3::new(0.0, f32::INFINITY, 0.0);
    assert_eq!(GraspMap::try_new(&[here, there], nowhere).unwrap_err(), GraspMapError::Origin);
}
