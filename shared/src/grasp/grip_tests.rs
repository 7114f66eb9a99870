use nalgebra::{Vector3, Vector6};

use super::tests::{Random, contact, hand3_grasp};
use super::*;
use crate::math::sqrt;

type StoredContact = ([f32; 3], [f32; 3], f32, f32);

/// Margin, minimum normal force, load; contacts as position, normal, friction, limit; half the minimum sum of
/// squares, if the load can be held; whether it is on the boundary of what can (`tests/oracles/grip.py`).
#[allow(clippy::type_complexity)]
const CASES: &[(f32, f32, [f32; 6], &[StoredContact], Option<f32>, bool)] =
    include!("../../../tests/oracles/data/grip.in");

const FREE: LeastGrip = LeastGrip { margin: 0.0, min_force: 0.0, tolerance: 0.0 };

/// An object of 40 mm between two opposing fingers along x.
fn pinch(friction: f32, limit: f32) -> GraspMap {
    let contacts = [
        contact([-0.02, 0.0, 0.1], [1.0, 0.0, 0.0], friction, limit),
        contact([0.02, 0.0, 0.1], [-1.0, 0.0, 0.0], friction, limit),
    ];
    GraspMap::try_new(&contacts, Vector3::new(0.0, 0.0, 0.1)).unwrap()
}

fn lift(weight: f32) -> Vector6<f32> {
    Vector6::new(0.0, 0.0, weight, 0.0, 0.0, 0.0)
}

fn solve(grip: &LeastGrip, map: &GraspMap, load: &Vector6<f32>) -> Result<Grip, GripError> {
    grip.solve(map, load, &mut GripState::default())
}

/// A stored grasp and its load.
fn stored(case: usize) -> (LeastGrip, GraspMap, Vector6<f32>) {
    let (margin, min_force, load, contacts, ..) = CASES[case];
    let contacts: Vec<Contact> = contacts
        .iter()
        .map(|&(position, normal, friction, limit)| contact(position, normal, friction, limit))
        .collect();
    let map = GraspMap::try_new(&contacts, Vector3::zeros()).unwrap();
    (LeastGrip::try_new(margin, min_force).unwrap(), map, Vector6::from(load))
}

/// Largest violation of balance, cones and limits, over the load.
fn violation(grip: &LeastGrip, map: &GraspMap, load: &Vector6<f32>, forces: &[Vector3<f32>]) -> f32 {
    let (force, moment) = map.scaled(&(load - map.wrench(forces)));
    let (load_force, load_moment) = map.scaled(load);
    let norm = sqrt(load_force.norm_squared() + load_moment.norm_squared());
    let mut worst = sqrt(force.norm_squared() + moment.norm_squared());
    for (contact, force) in map.contacts().iter().zip(forces) {
        let along = contact.normal().dot(force);
        let across = (force - contact.normal() * along).norm();
        let friction = contact.friction() * (1.0 - grip.margin);
        for excess in [across - friction * along, along - contact.limit(), grip.min_force - along] {
            worst = worst.max(excess);
        }
    }
    worst / norm
}

#[test]
fn two_fingers_pinch_with_the_weight_over_twice_the_friction() {
    let weight = 0.2 * 9.81;
    let grip = solve(&FREE, &pinch(0.5, 20.0), &lift(weight)).unwrap();
    let push = weight / (2.0 * 0.5);
    for (force, side) in grip.forces.iter().zip([1.0, -1.0]) {
        assert!((force - Vector3::new(side * push, 0.0, weight / 2.0)).norm() < 2e-4, "{grip:?}");
    }
    // With a fifth of the friction left unused.
    let careful = LeastGrip::try_new(0.2, 0.0).unwrap();
    let grip = solve(&careful, &pinch(0.5, 20.0), &lift(weight)).unwrap();
    assert!((grip.forces[0].x - weight / (2.0 * 0.4)).abs() < 2e-4);
    // Limits of 10 N and a friction of 0.5 carry 10 N.
    assert!(solve(&FREE, &pinch(0.5, 10.0), &lift(9.9)).is_ok());
    assert!(matches!(solve(&FREE, &pinch(0.5, 10.0), &lift(10.1)), Err(GripError::CannotHold(_))));
}

#[test]
fn three_fingers_share_a_weight_as_worked_by_hand() {
    // The weight is centred: finger 3 carries half of it, and the others together push as hard as finger 3.
    let (weight, friction) = (2.0, 0.4);
    let load = Vector6::new(0.0, 0.0, weight, 0.0, -0.03 * weight, 0.0);
    let grip = solve(&FREE, &hand3_grasp(friction), &load).unwrap();
    let push = weight / 2.0 / friction;
    let expected = [(push / 2.0, weight / 4.0), (push / 2.0, weight / 4.0), (-push, weight / 2.0)];
    for (force, (x, z)) in grip.forces.iter().zip(expected) {
        assert!((force - Vector3::new(x, 0.0, z)).norm() < 2e-4, "{grip:?}");
    }
}

#[test]
fn forces_inside_all_cones_are_those_of_the_pseudo_inverse() {
    let mut random = Random(8);
    let mut seen = 0;
    for _ in 0..300 {
        // A tray on five points, which push up and hold sideways by about a tenth of that.
        let contacts: Vec<Contact> = (0..5)
            .map(|_| {
                contact(
                    [random.between(-0.1, 0.1), random.between(-0.1, 0.1), 0.0],
                    [0.0, 0.0, 1.0],
                    0.5,
                    9.0,
                )
            })
            .collect();
        let map = GraspMap::try_new(&contacts, Vector3::zeros()).unwrap();
        let made: Vec<Vector3<f32>> = contacts.iter().map(|_| Vector3::z() + random.vector(0.1)).collect();
        let load = map.wrench(&made);
        let minimum = map.inverse().forces(&load).unwrap();
        if violation(&FREE, &map, &load, &minimum) < 1e-5 {
            seen += 1;
            let grip = solve(&FREE, &map, &load).unwrap();
            assert!(grip.steps <= 3);
            for (force, minimum) in grip.forces.iter().zip(&minimum) {
                assert!((force - minimum).norm() < 1e-4);
            }
        }
    }
    assert!(seen > 100, "{seen}");
}

#[test]
fn infeasible_loads_are_refused_with_a_certificate() {
    let moment = Vector6::new(0.0, 0.0, 0.0, 0.1, 0.0, 0.0);
    for (map, load) in [
        // No friction; a moment about the line of two fingers; too heavy; a pull.
        (pinch(0.0, 20.0), lift(1.0)),
        (pinch(0.5, 20.0), moment),
        (pinch(0.5, 20.0), lift(50.0)),
        (hand3_grasp(0.0), lift(1.0)),
        (hand3_grasp(0.1), lift(10.0)),
    ] {
        let Err(GripError::CannotHold(certificate)) = solve(&FREE, &map, &load) else { panic!("{load}") };
        assert!(certificate.is_valid(&FREE, &map, &load));
        // It is no proof for a load that can be held, nor in the opposite direction.
        assert!(!certificate.is_valid(&FREE, &map, &(load * 0.0)));
        assert!(!certificate.is_valid(&FREE, &map, &-load));
    }
    // All normals in one direction: no force in the opposite direction.
    let one_way = [[0.0, 0.02, 0.0], [0.0, -0.02, 0.0], [0.0, 0.0, 0.03]]
        .map(|position| contact(position, [1.0, 0.0, 0.0], 0.5, 20.0));
    let map = GraspMap::try_new(&one_way, Vector3::zeros()).unwrap();
    let back = Vector6::new(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    assert!(matches!(solve(&FREE, &map, &back), Err(GripError::CannotHold(_))));
    assert!(solve(&FREE, &map, &Vector6::new(1.0, 0.0, 0.0, 0.0, 0.01, 0.0)).is_ok());
    let nonsense = Certificate { twist: Vector6::repeat(f32::NAN) };
    assert!(!nonsense.is_valid(&FREE, &map, &back));
}

#[test]
fn every_contact_pushes_with_the_minimum_force() {
    let grip = LeastGrip::try_new(0.1, 0.3).unwrap();
    let idle = solve(&grip, &pinch(0.5, 20.0), &lift(0.0)).unwrap();
    assert!((idle.forces[0] - Vector3::new(0.3, 0.0, 0.0)).norm() < 1e-4, "{idle:?}");
    let nothing = solve(&FREE, &pinch(0.5, 20.0), &lift(0.0)).unwrap();
    assert_eq!(nothing.forces[..], [Vector3::zeros(); 2]);
}

#[test]
fn the_next_search_starts_where_the_last_one_ended() {
    let map = hand3_grasp(0.5);
    let load = Vector6::new(0.1, 0.2, 2.0, 0.001, -0.05, 0.002);
    let mut state = GripState::default();
    let first = FREE.solve(&map, &load, &mut state).unwrap();
    let again = FREE.solve(&map, &load, &mut state).unwrap();
    assert!(first.steps > 1 && again.steps == 0, "{} {}", first.steps, again.steps);
    // A state with NaN does no harm, and a refusal leaves the state unchanged.
    let before = state.clone();
    assert!(FREE.solve(&map, &(load * 100.0), &mut state).is_err());
    assert_eq!(state, before);
    let mut broken = GripState { twist: [f32::NAN; 6], search: None };
    assert!(FREE.solve(&map, &load, &mut broken).is_ok());
}

#[test]
fn a_start_from_another_grasp_does_no_harm() {
    let mut state = GripState::default();
    let mut open = 0;
    for (case, (.., objective, boundary)) in CASES.iter().enumerate() {
        let (grip, map, load) = stored(case);
        match grip.solve(&map, &load, &mut state) {
            Ok(found) => {
                let sum = 0.5 * found.forces.iter().map(Vector3::norm_squared).sum::<f32>();
                assert!(*boundary || (sum / objective.unwrap() - 1.0).abs() < 1e-3);
            }
            Err(GripError::CannotHold(_)) => assert!(objective.is_none()),
            Err(_) => open += 1,
        }
    }
    assert!(open <= 3, "{open}");
}

#[test]
fn slices_end_where_one_call_does() {
    let mut unfinished = 0;
    for case in 0..CASES.len() {
        let (grip, map, load) = stored(case);
        let whole = solve(&grip, &map, &load);
        // One step per call; some four steps with three contacts.
        for budget in [0, 25_000] {
            let mut state = GripState::default();
            for calls in 1.. {
                let result = grip.advance(&map, &load, &mut state, budget);
                // The search is part of the exported state of a board.
                let bytes = postcard::to_allocvec(&state).unwrap();
                assert!(bytes.len() <= 59);
                state = postcard::from_bytes(&bytes).unwrap();
                if !matches!(result, Err(GripError::Unfinished { .. })) {
                    assert_eq!(result, whole, "{case}");
                    assert!(state.search.is_none() && calls <= 40);
                    break;
                }
                unfinished += 1;
            }
        }
    }
    assert!(unfinished > 1000, "{unfinished}");
}

#[test]
fn a_search_continues_with_the_contacts_and_the_load_of_the_call() {
    let mut random = Random(9);
    let (mut state, mut calls, mut answers) = (GripState::default(), 0, 0);
    for tick in 0..2000_u16 {
        // Rolling fingertips, an object that oscillates, and now and then a different load.
        let phase = f32::from(tick) * 0.01;
        let sway = Vector3::new(0.002 * sqrt(phase), 0.0003 * phase, 0.0);
        let map = hand3_grasp(0.5);
        let moved: Vec<Contact> = map
            .contacts()
            .iter()
            .map(|of| {
                let position = of.position() + sway + random.vector(2e-5);
                Contact::try_new(position, of.normal() + random.vector(0.002), 0.5, 20.0).unwrap()
            })
            .collect();
        let map = GraspMap::try_new(&moved, Vector3::zeros()).unwrap();
        let weight = if tick % 400 < 200 { 2.0 } else { -1.0 };
        let load = Vector6::new(0.1 * phase, 0.2, weight, 0.001, -0.03 * weight, 0.002);
        calls += 1;
        match FREE.advance(&map, &load, &mut state, 0) {
            Ok(grip) => {
                assert!(violation(&FREE, &map, &load, &grip.forces) < 1e-4, "{tick}");
                let best = solve(&FREE, &map, &load).unwrap();
                let sum = |grip: &Grip| grip.forces.iter().map(Vector3::norm_squared).sum::<f32>();
                assert!((sum(&grip) / sum(&best) - 1.0).abs() < 1e-3, "{tick}");
                (calls, answers) = (0, answers + 1);
            }
            Err(GripError::Unfinished { residual }) => assert!(residual.is_finite() && calls < 40),
            Err(error) => panic!("{tick}: {error}"),
        }
    }
    assert!(answers > 1000, "{answers}");
    // A search that is interrupted in one grasp continues in another.
    let mut open = 0;
    for case in 0..CASES.len() {
        let (grip, map, load) = stored(case);
        let whole = solve(&grip, &map, &load);
        match grip.solve(&map, &load, &mut state) {
            Ok(found) => {
                assert!(whole.is_ok() && violation(&grip, &map, &load, &found.forces) < 1e-4, "{case}");
            }
            Err(GripError::CannotHold(certificate)) => assert!(certificate.is_valid(&grip, &map, &load)),
            Err(_) => open += 1,
        }
        let _ = grip.advance(&map, &(load * 0.7), &mut state, 0);
    }
    assert!(open <= 3, "{open}");
}

/// The paper's box while weights are put on it, measured with noise, with one step of the search per tick.
#[test]
fn a_measured_load_is_followed() {
    let mut random = Random(17);
    let mut noise = || random.between(-0.02, 0.02);
    let grip = LeastGrip::try_new(0.2, 0.3).unwrap();
    for tolerance in [-0.01, 1.01, f32::INFINITY] {
        let refused = grip.clone().with_tolerance(tolerance);
        assert_eq!(refused, Err(InvalidGripSettings::Tolerance(tolerance)));
    }
    let grip = grip.with_tolerance(0.02).unwrap();
    let map = hand3_grasp(0.5);
    let (mut state, mut waiting, mut answers) = (GripState::default(), 0, 0);
    // Converged before the first tick.
    grip.solve(&map, &lift(0.2), &mut state).unwrap();
    for tick in 0..1000_u16 {
        let weight = 0.2 + 6.0 * (f32::from(tick % 200) / 30.0).min(1.0);
        let load =
            Vector6::new(noise(), noise(), weight + noise(), 0.1 * noise(), 0.1 * noise(), 0.1 * noise());
        match grip.advance(&map, &load, &mut state, 0) {
            Ok(found) => {
                assert!(
                    found.residual <= 0.02 && violation(&grip, &map, &load, &found.forces) < 0.0201,
                    "{tick}"
                );
                let best = solve(&LeastGrip::try_new(0.2, 0.3).unwrap(), &map, &load).unwrap();
                let sum = |grip: &Grip| grip.forces.iter().map(Vector3::norm_squared).sum::<f32>();
                assert!(
                    (sum(&found) / sum(&best) - 1.0).abs() < 0.06,
                    "{tick}: {}",
                    sum(&found) / sum(&best)
                );
                (waiting, answers) = (0, answers + 1);
            }
            Err(GripError::Unfinished { .. }) => {
                waiting += 1;
                assert!(waiting <= 3, "{tick}");
            }
            Err(error) => panic!("{tick}: {error}"),
        }
    }
    assert!(answers > 900, "{answers}");
}

#[test]
fn a_damaged_search_does_no_harm() {
    let (map, load) = (hand3_grasp(0.5), Vector6::new(0.1, 0.2, 2.0, 0.001, -0.05, 0.002));
    let mut interrupted = GripState::default();
    assert!(matches!(FREE.advance(&map, &load, &mut interrupted, 0), Err(GripError::Unfinished { .. })));
    let bytes = postcard::to_allocvec(&interrupted).unwrap();
    for index in 0..bytes.len() {
        for bit in 0..8 {
            let mut bytes = bytes.clone();
            bytes[index] ^= 1 << bit;
            let Ok(mut state) = postcard::from_bytes::<GripState>(&bytes) else { continue };
            match FREE.solve(&map, &load, &mut state) {
                Ok(grip) => assert!(violation(&FREE, &map, &load, &grip.forces) < 1e-4),
                Err(GripError::NotConverged { .. }) => assert_eq!(state, GripState::default()),
                Err(error) => panic!("{error}"),
            }
        }
    }
}

#[test]
fn bad_input_is_refused_by_name() {
    assert_eq!(LeastGrip::try_new(1.0, 0.0), Err(InvalidGripSettings::Margin(1.0)));
    assert!(matches!(LeastGrip::try_new(f32::NAN, 0.0), Err(InvalidGripSettings::Margin(_))));
    assert_eq!(LeastGrip::try_new(0.1, -1.0), Err(InvalidGripSettings::MinForce(-1.0)));
    assert_eq!(LeastGrip::try_new(0.1, f32::INFINITY), Err(InvalidGripSettings::MinForce(f32::INFINITY)));
    let map = pinch(0.5, 2.0);
    assert_eq!(solve(&FREE, &map, &lift(f32::NAN)), Err(GripError::NotFinite));
    let strong = LeastGrip::try_new(0.1, 3.0).unwrap();
    assert_eq!(solve(&strong, &map, &lift(1.0)), Err(GripError::Limit { contact: 0, limit: 2.0 }));
}

#[test]
fn is_as_small_as_cvxpys_and_refuses_what_cvxpy_finds_infeasible() {
    let (mut held, mut refused, mut open) = (0, 0, 0);
    for (index, &(.., objective, boundary)) in CASES.iter().enumerate() {
        let (grip, map, load) = stored(index);
        match (solve(&grip, &map, &load), objective) {
            (Ok(found), _) => {
                held += 1;
                let worst = violation(&grip, &map, &load, &found.forces);
                assert!(worst < 1e-4, "{index}: {worst}");
                assert!(objective.is_some() || boundary, "{index} cannot be held");
                let sum = 0.5 * found.forces.iter().map(Vector3::norm_squared).sum::<f32>();
                if let Some(objective) = objective
                    && !boundary
                {
                    assert!((sum / objective - 1.0).abs() < 1e-3, "{index}: {sum} {objective}");
                }
            }
            (Err(GripError::CannotHold(certificate)), objective) => {
                refused += 1;
                assert!(
                    certificate.is_valid(&grip, &map, &load) && objective.is_none(),
                    "{index} can be held"
                );
            }
            // Not converged: on the boundary, or where only forces of many times the load could hold.
            (Err(error), _) => {
                open += 1;
                println!("{index}, on the boundary: {boundary}: {error}");
            }
        }
    }
    assert!(held > 140 && refused > 100 && open <= 2, "{held} {refused} {open}");
}
