use super::dither::{decaying_sine, tangential_directions};
use super::*;
use crate::TICK;
use crate::task::grasping::tuning::{DITHER_TIME, TANGENTIAL_DITHER_PERIODS};

/// The paper's box, and fingers that press on it with the largest normal force `strength` [N].
fn grasp(strength: f32, friction: f32) -> ([Contact; 3], Forces) {
    let at = |x, y, normal| Contact::try_new(Vector3::new(x, y, 0.0), normal, friction, 9.0).unwrap();
    let inward = Vector3::x();
    let contacts = [at(-0.049, 0.04, inward), at(-0.049, -0.04, inward), at(0.049, 0.0, -inward)];
    let half = 0.5 * strength;
    let base = [[half, 0.0, 0.0], [half, 0.0, 0.0], [-strength, 0.0, 0.0]];
    (contacts, Forces { base, ..Forces::new(friction) })
}

/// Fingers 1 and 2 towards each other, and towards finger 3, 98 mm along x and 40 mm along y away.
fn directions() -> PerFinger<[Vector3<f32>; 2]> {
    let (x, y) = (0.925_85, 0.377_90);
    [
        [-Vector3::y(), Vector3::new(x, -y, 0.0)],
        [Vector3::y(), Vector3::new(-x, -y, 0.0)],
        [Vector3::zeros(), Vector3::new(0.0, 2.0 * y, 0.0)],
    ]
}

/// The box held by fingers whose joints push along the axes, 0.1 N·m for a newton, with the torque limit
/// `torque` [N·m] and the `measured` forces [N].
fn with_inputs<T>(
    torque: f32,
    measured: &PerFinger<Vector3<f32>>,
    act: impl FnOnce(&ForceInputs<'_>) -> T,
) -> T {
    let (contacts, _) = grasp(0.0, 0.5);
    let mut jacobian = crate::kinematics::Jacobian::zeros();
    (0..3).for_each(|axis| jacobian[(axis, axis)] = 0.1);
    act(&ForceInputs {
        map: &GraspMap::try_new(&contacts, Vector3::zeros()).unwrap(),
        measured,
        anchor_errors: [0.0; 3],
        internal: InternalForce::LeastGrip { margin: 0.2, capacity_at_rest: 0.22, capacity_in_motion: 0.6 },
        feedback: true,
        is_held: true,
        known_load: None,
        is_lifted: true,
        load_feedforward: 0.9,
        in_motion: false,
        three: &ThreeFingers::new(&[(jacobian, Vector3::zeros()); 3]),
        torque_limits: [[torque; 3]; 3],
    })
}

/// Runs one tick and returns the commanded internal forces [N].
fn tick(forces: &mut Forces, torque: f32, measured: &PerFinger<Vector3<f32>>) -> PerFinger<Vector3<f32>> {
    with_inputs(torque, measured, |inputs| {
        forces.update_estimates(inputs);
        forces.solve_grip(inputs, &inputs.map.inverse(), 1.0, &[Vector3::zeros(); 3]).internal
    })
}

/// Forces of fingers that press with `strength` and carry a `weight` [N].
fn pressing(strength: f32, weight: f32) -> PerFinger<Vector3<f32>> {
    let [one, three] = [0.25, 0.5].map(|fraction| Vector3::new(0.0, 0.0, fraction * weight));
    let push = Vector3::new(strength, 0.0, 0.0);
    [one + push * 0.5, one + push * 0.5, three - push]
}

#[test]
fn forces_of_a_support_do_not_count_as_an_error_of_internal_forces() {
    let target = pressing(2.0, 0.0).map(Into::into);
    let forces = Forces { target, ..Forces::new(0.5) };
    let have_converged =
        |measured| with_inputs(1.0, &measured, |inputs| forces.have_converged(inputs, &inputs.map.inverse()));
    // An external force of 1.5 N on the box, a third on each finger: the internal forces stay on target.
    let [one, two, three] = pressing(2.0, 0.0);
    let push = Vector3::new(0.5, 0.0, 0.0);
    assert!(have_converged([one, two, three]));
    assert!(have_converged([one + push, two + push, three + push]));
    assert!(!have_converged([one * 0.7, two * 0.7, three * 0.7]));
}

/// Forces that push the box, of contacts that have moved since they were corrections of internal forces.
#[test]
fn a_correction_of_internal_forces_stays_internal() {
    let (_, mut forces) = grasp(0.0, 0.5);
    forces.correction = [[0.4, 0.0, 0.1], [0.3, 0.1, 0.1], [0.2, -0.1, 0.1]];
    // Beyond the dead band.
    let measured = pressing(2.0, 0.0);
    tick(&mut forces, 1.0, &measured);
    let wrench =
        with_inputs(1.0, &measured, |inputs| inputs.map.wrench(&forces.correction.map(Vector3::from)));
    assert!(wrench.norm() < 1e-5, "{wrench}");
    assert!(forces.correction[2][0] > 0.0, "the grip of 2 N is to be less: {:?}", forces.correction);
}

/// Something holds an object under wrench control: what its control commands is measured as load.
#[test]
fn the_weight_that_is_fed_forward_is_bounded() {
    let (_, mut forces) = grasp(0.0, 0.5);
    for _ in 0..300 {
        let [one, two, three] = pressing(2.0, 0.0);
        let more = Vector6::from(forces.weight).fixed_rows::<3>(0).into_owned() + Vector3::z() * 9.0;
        let measured = [one + more / 3.0, two + more / 3.0, three + more / 3.0];
        with_inputs(1.0, &measured, |inputs| forces.update_estimates(inputs));
    }
    let weight = Vector6::from(forces.weight);
    assert!((weight[2] - 10.0).abs() < 1e-6 && weight[0].abs() < 1e-3, "{weight}");
}

/// Finger 3 bears what fingers 1 and 2 press: 18 N, of which a contact may have 9.
#[test]
fn a_grip_beyond_a_limit_is_reduced_as_a_whole() {
    for internal in [
        InternalForce::Pairwise { strengths: [9.0, 9.0, 0.0] },
        InternalForce::Pairwise { strengths: [9.0, 9.0, 9.0] },
        InternalForce::Normal { strength: 9.0 },
    ] {
        let (_, mut forces) = grasp(0.0, 0.5);
        let at_rest = [Vector3::zeros(); 3];
        let (internal, pushes) = with_inputs(10.0, &at_rest, |inputs| {
            let inputs = ForceInputs { internal, feedback: false, ..*inputs };
            let grip = forces.solve_grip(&inputs, &inputs.map.inverse(), 1.0, &at_rest).internal;
            (grip, inputs.map.wrench(&grip).norm())
        });
        assert!(pushes < 1e-4, "{pushes}: {internal:?}");
        let largest = internal.iter().map(|force| force.x.abs()).fold(0.0, f32::max);
        assert!((8.9..=9.0 + 1e-4).contains(&largest), "{internal:?}");
    }
}

#[test]
fn feedback_rests_in_the_dead_band() {
    let (_, mut forces) = grasp(0.0, 0.5);
    // A capacity of 0.22 N needs 0.44 N of fingers 1 and 2, and of finger 3 the sum of both.
    for _ in 0..300 {
        tick(&mut forces, 1.0, &pressing(0.9, 0.3));
    }
    let target = forces.target.map(|force| force[0]);
    assert!((target[0] - 0.44).abs() < 2e-3 && (target[2] + 0.88).abs() < 4e-3, "{target:?}");
    let correction = forces.correction;
    tick(&mut forces, 1.0, &pressing(0.98, 0.3));
    assert_eq!(correction, forces.correction);
    tick(&mut forces, 1.0, &pressing(1.2, 0.3));
    assert!(forces.correction[2][0] > correction[2][0], "released");
    let correction = forces.correction;
    tick(&mut forces, 1.0, &pressing(0.8, 0.3));
    assert!(forces.correction[2][0] < correction[2][0], "pressed harder");
}

#[test]
fn feedback_exceeds_no_limit_of_a_contact() {
    let (_, mut forces) = grasp(0.0, 0.5);
    // A load that needs a grip near the limit of 9 N, and sensors that read half of the forces of the
    // fingers.
    let mut command = [Vector3::zeros(); 3];
    for _ in 0..1000 {
        let measured = pressing(4.0, 3.0);
        command = tick(&mut forces, 10.0, &measured);
    }
    let [.., third] = command;
    assert!(third.x < -4.5 && third.x >= -9.0, "{third}");
}

#[test]
fn a_growing_load_tightens_the_grip_at_once() {
    let (_, mut forces) = grasp(0.0, 0.5);
    for _ in 0..300 {
        tick(&mut forces, 1.0, &pressing(0.9, 0.3));
    }
    // 10 N/s, measured for two ticks.
    for weight in [0.4, 0.5] {
        tick(&mut forces, 1.0, &pressing(0.9, weight));
    }
    let target = forces.target.map(|force| force[0]);
    // A preload of 4 N for each newton of the anticipated load, which is above 0.12 N. Without it, 0.63 N
    // against 0.94 N hold a weight of 0.5 N.
    assert!(target[0] > 0.44 + 0.4 && target[2] < -0.88 - 0.8, "{target:?}");
}

#[test]
fn saturated_joints_scale_the_forces_and_stop_the_integrator() {
    let (_, mut forces) = grasp(0.0, 0.5);
    // Finger 3 carries half of 3 N, and has to press with 3.75 N, 0.375 N·m. Motors that are weaker than in
    // the model make 3.2 N.
    let mut command = 0.0;
    for _ in 0..300 {
        command = tick(&mut forces, 0.4, &pressing(3.2, 3.0))[2].x;
        assert!(command > -4.0001, "{command}");
    }
    let correction = forces.correction[2][0];
    assert!((command + 4.0).abs() < 1e-3 && (correction + 0.25).abs() < 0.02, "{command} {correction}");
}

#[test]
fn normal_dither_exceeds_no_limit() {
    let (contacts, forces) = grasp(4.0, 0.4);
    assert!((forces.max_normal_dither(&contacts, 0.5) - 0.5).abs() < 1e-6);
    // From 8 N to the limit of 9 N it is an eighth.
    let (contacts, forces) = grasp(8.0, 0.4);
    let amplitude = forces.max_normal_dither(&contacts, 0.5);
    assert!((amplitude - 0.125).abs() < 1e-6, "{amplitude}");
    let dither = forces.scaled_base(amplitude);
    assert!((dither[2] - Vector3::new(-1.0, 0.0, 0.0)).norm() < 1e-6, "{dither:?}");
    let (contacts, forces) = grasp(9.5, 0.4);
    assert!(forces.max_normal_dither(&contacts, 0.5).abs() < 1e-6);

    // With a load all fingers are scaled alike: finger 3 has headroom for 0.5 N of 1 N.
    let load = [Vector3::zeros(), Vector3::zeros(), Vector3::new(-0.5, 0.3, 0.0)];
    let (contacts, forces) = grasp(8.0, 0.4);
    let internal = forces.scaled_base(1.0);
    let scale = superposition_scale(&contacts, &internal, &load, &dither);
    assert!((scale - 0.5).abs() < 1e-6, "{scale}");
    // In the opposite direction there is headroom for all of it.
    let opposite = dither.map(|force| -force);
    assert!((superposition_scale(&contacts, &internal, &load, &opposite) - 1.0).abs() < 1e-6);
}

#[test]
fn tangential_dither_makes_no_contact_slide() {
    let (contacts, forces) = grasp(4.0, 0.8);
    assert!((forces.max_tangential_dither(&contacts, &directions(), 0.4) - 0.4).abs() < 1e-6);
    // For fingers 1 and 2, 0.8 · 0.05 · (2 − 0.92585 s) = 1.37790 s.
    let (contacts, forces) = grasp(4.0, 0.05);
    let amplitude = forces.max_tangential_dither(&contacts, &directions(), 0.4);
    assert!((amplitude - 0.056_540).abs() < 1e-5, "{amplitude}");
    for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
        for (contact, force, directions) in zip((&contacts, &forces.base, &directions())) {
            let dither = (directions[0] * signs[0] + directions[1] * signs[1]) * amplitude;
            let force = Vector3::from(*force) + dither;
            let normal = contact.normal().dot(&force);
            let tangential = (force - contact.normal() * normal).norm();
            assert!(normal < 9.0 && tangential <= 0.8 * 0.05 * normal + 1e-6, "{normal} {tangential}");
        }
    }
    // Much friction, little headroom: 9 N less 8.9 N over 0.92585.
    let (contacts, forces) = grasp(17.8, 1.0);
    let amplitude = forces.max_tangential_dither(&contacts[..2], &directions(), 1.0);
    assert!((amplitude - 0.108_01).abs() < 1e-4, "{amplitude}");
}

#[test]
fn tangential_dither_has_no_wrench() {
    // The paper's box: 98 mm along x and 40 mm along y from finger 1 to finger 3.
    let (contacts, _) = grasp(0.0, 0.4);
    let found = tangential_directions(&contacts);
    for (found, expected) in found.iter().flatten().zip(directions().iter().flatten()) {
        assert!((found - expected).norm() < 1e-5, "{found} {expected}");
    }
    // The same for arbitrary contacts and normals, about any point.
    let at = |x, y, z| Contact::try_new(Vector3::new(x, y, z), Vector3::new(y, z, x), 0.4, 9.0).unwrap();
    let contacts = [at(0.03, 0.05, -0.02), at(-0.06, 0.01, 0.04), at(0.02, -0.07, 0.03)];
    let directions = tangential_directions(&contacts);
    let about = Vector3::new(0.3, -0.2, 0.1);
    for kind in 0..2 {
        let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
        for (contact, directions) in contacts.iter().zip(&directions) {
            force += directions[kind];
            moment += (contact.position() - about).cross(&directions[kind]);
        }
        assert!(force.norm() < 1e-6 && moment.norm() < 1e-6, "{force} {moment}");
        assert!(directions[0][kind].norm() > 0.99);
    }
}

#[test]
fn dither_decays_to_zero_and_has_zero_mean() {
    for period in TANGENTIAL_DITHER_PERIODS {
        assert!(decaying_sine(-TICK, period) == 0.0 && decaying_sine(DITHER_TIME, period) == 0.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of ticks")]
        let ticks = (DITHER_TIME / TICK) as u16;
        let values: heapless::Vec<f32, 1000> =
            (0..ticks).map(|tick| decaying_sine((f32::from(tick) + 0.01) * TICK, period)).collect();
        let max = |part: &[f32]| part.iter().fold(0.0, |max, value| f32::max(max, value.abs()));
        let (begin, end) = (max(&values[..12]), max(&values[values.len() - 8..]));
        assert!(begin > 0.8 && begin < 1.0 && end < 0.08, "{begin} {end}");
        let mean = values.iter().sum::<f32>() / f32::from(ticks);
        assert!(mean.abs() < 0.02, "{mean}");
    }
}

/// The force that the Hand3 paper commands to finger 1 (section 6.1) is that of 2 N along the x axis of a box
/// pitched by 0.769 rad, and a third of the weight of 23 g: (1.48, 0, −1.34) N. The paper's pitch and forces
/// are rounded.
#[test]
fn a_known_load_makes_the_force_that_the_paper_commands() {
    let rotation = crate::math::rotation_matrix(&Vector3::new(0.0, 0.769, 0.0));
    let centroid = Vector3::new(-0.049 / 3.0, 0.0, 0.0);
    let at = |x, y, normal: f32| {
        let position = rotation * (Vector3::new(x, y, 0.0) - centroid);
        Contact::try_new(position, rotation * Vector3::x() * normal, 0.6, 9.0).unwrap()
    };
    let contacts = [at(-0.049, 0.04, 1.0), at(-0.049, -0.04, 1.0), at(0.049, 0.0, -1.0)];
    let map = GraspMap::try_new(&contacts, Vector3::zeros()).unwrap();
    let weight = 0.023 * 6.9367;
    let target = with_inputs(1.0, &pressing(0.0, 9.0), |inputs| {
        let known_load = Some(Vector6::new(weight, 0.0, weight, 0.0, 0.0, 0.0));
        let internal = InternalForce::Normal { strength: 4.0 };
        let inputs = ForceInputs { map: &map, internal, known_load, feedback: false, ..*inputs };
        let mut forces = Forces::new(0.6);
        // The measured weight of 9 N does not count.
        forces.update_estimates(&inputs);
        forces.solve_grip(&inputs, &map.inverse(), 1.0, &[Vector3::zeros(); 3]);
        Vector3::from(forces.target[0])
    });
    assert!((target - Vector3::new(1.48, 0.0, -1.34)).amax() < 0.011, "{target}");
}

/// Finger 3 presses with 1 N and holds 0.44 N, below the 0.485 N of incipient slip at a friction of 0.5. The
/// noise of its sensor has a standard deviation of 0.02 N in each direction: one sample beyond three of them
/// is no slip, a lasting load is.
#[test]
fn noise_of_one_sample_is_no_incipient_slip() {
    let (_, mut forces) = grasp(1.0, 0.5);
    let mut slips = |weights: &[f32]| {
        for &weight in weights {
            with_inputs(1.0, &pressing(1.0, weight), |inputs| forces.update_estimates(inputs));
        }
        forces.slips
    };
    assert_eq!(slips(&[0.88; 20]), 0);
    assert_eq!(slips(&[1.1, 0.88, 0.88, 1.1, 0.88]), 0);
    assert!((1..=3).contains(&slips(&[1.1; 5])));
}

/// Finger 3 carries half of the weight with the ratio of tangential to normal force that equals the friction.
#[test]
fn a_slip_lowers_the_estimated_friction_but_never_raises_it() {
    for (friction, lowest) in [(0.08, 0.08), (0.5, 0.3)] {
        let (_, mut forces) = grasp(4.0, friction);
        let measured = pressing(4.0, 8.0 * friction);
        for error in [1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4] {
            with_inputs(1.0, &measured, |inputs| {
                forces.update_estimates(&ForceInputs { anchor_errors: [0.0, 0.0, error], ..*inputs });
            });
        }
        assert!(forces.slips >= 4, "{friction}: {} slips", forces.slips);
        assert!((lowest..=friction).contains(&forces.friction), "{friction}: {}", forces.friction);
        assert!(forces.friction < friction || friction < 0.1, "{friction}");
    }
}
