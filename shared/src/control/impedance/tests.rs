//! The impedance against scipy, and the refusals.

use super::*;

const SOFT: Impedance = Impedance::diagonal([1.5; 6], [7.5; 6], [300.0; 6]);

/// The acceleration for a displacement and its velocity.
type Law<'a> = dyn Fn(&Vector6<f32>, &Vector6<f32>) -> Vector6<f32> + 'a;

/// Positions [m] every 10 ms of a mass that is released 30 mm off, from scipy's matrix exponential
/// (`tests/oracles/impedance.py`): M 1.5, K 300; B 7.5, 30, 90 (overdamped).
const RELEASES: &[(f32, &[f64])] = include!("../../../../tests/oracles/data/impedance.in");

#[test]
#[allow(clippy::cast_possible_truncation, reason = "single precision")]
fn matched_it_stays_on_the_exact_curve_where_the_printed_law_does_not() {
    for &(damping, exact) in RELEASES {
        let impedance = Impedance { damping: [damping; 6], ..SOFT };
        let discrete = impedance.discretized();
        let run = |law: &Law<'_>| {
            let (mut e, mut v) = (Vector6::repeat(0.03), Vector6::zeros());
            let mut worst = 0.0_f64;
            for exact in exact {
                worst = worst.max((f64::from(e.x) - exact).abs());
                let a = law(&e, &v);
                e += v * TICK + a * (0.5 * TICK * TICK);
                v += a * TICK;
            }
            worst
        };
        let zero = Vector6::zeros();
        let (ours, printed) = (
            run(&|e, v| discrete.acceleration(e, v, &zero)),
            run(&|e, v| impedance.acceleration(e, v, &zero)),
        );
        assert!(ours < 7e-5, "B {damping}: {ours}");
        assert!(printed > 4e-4, "B {damping}: {printed}");
    }
}

#[test]
fn a_constant_force_is_yielded_to_by_its_size_over_the_stiffness() {
    let discrete = SOFT.discretized();
    let (mut e, mut v) = (Vector6::zeros(), Vector6::zeros());
    let force = Vector6::repeat(3.0);
    for _ in 0..1000 {
        let a = discrete.acceleration(&e, &v, &force);
        e += v * TICK + a * (0.5 * TICK * TICK);
        v += a * TICK;
    }
    assert!((e.x - 0.01).abs() < 1e-6 && v.norm() < 1e-5, "{e} {v}");
}

type Matrix = ([f32; 6], [f32; 15]);
/// M, B, K; displacement, velocity, force; accelerations of printed law and exact motion; rotation; M, B, K
/// in other axes. From numpy and scipy (`tests/oracles/impedance_matrices.py`).
type Coupled = (
    Matrix,
    Matrix,
    Matrix,
    [f32; 6],
    [f32; 6],
    [f32; 6],
    [f32; 6],
    [f32; 6],
    [f32; 9],
    Matrix,
    Matrix,
    Matrix,
);
#[allow(clippy::excessive_precision, reason = "the digits of the script")]
const COUPLED: &[Coupled] = include!("../../../../tests/oracles/data/impedance_matrices.in");

fn coupled(mass: &Matrix, damping: &Matrix, stiffness: &Matrix) -> Impedance {
    let coupling = ImpedanceCoupling { mass: mass.1, damping: damping.1, stiffness: stiffness.1 };
    Impedance { coupling: Some(coupling), ..Impedance::diagonal(mass.0, damping.0, stiffness.0) }
}

#[test]
fn coupled_axes_have_the_accelerations_of_the_exact_motion() {
    for (m, b, k, e, v, f, printed, held, ..) in COUPLED {
        let impedance = coupled(m, b, k);
        impedance.validate().unwrap();
        let [e, v, f] = [e, v, f].map(|values| Vector6::from(*values));
        let close = |value: Vector6<f32>, expected: &[f32; 6]| {
            let expected = Vector6::from(*expected);
            assert!((value - expected).norm() < 2e-5 * expected.norm(), "{value} {expected}");
        };
        close(impedance.acceleration(&e, &v, &f), printed);
        close(impedance.held_acceleration(&e, &v, &f), held);
        // The two differ by more than the error of each.
        let difference = Vector6::from(*printed) - Vector6::from(*held);
        assert!(difference.norm() > 1e-2 * Vector6::from(*held).norm());
    }
    // Without coupling, by the series as by the closed form.
    let none = Impedance { coupling: Some(ImpedanceCoupling::NONE), ..SOFT };
    let stiff = |i: Impedance| Impedance { damping: [140.0; 6], stiffness: [3700.0; 6], ..i };
    let (e, v, f) = (Vector6::repeat(0.03), Vector6::repeat(-0.2), Vector6::repeat(2.0));
    for (none, plain) in [(none, SOFT), (stiff(none), stiff(SOFT))] {
        let [a, b] = [none, plain].map(|impedance| impedance.held_acceleration(&e, &v, &f));
        assert!((a - b).norm() < 1e-5 * b.norm(), "{a} {b}");
    }
}

#[test]
fn in_turned_axes_the_matrices_are_turned() {
    for (m, b, k, .., turn, m2, b2, k2) in COUPLED {
        let rotation = Matrix3::from_row_slice(turn);
        let turned = coupled(m, b, k).in_axes(ImpedanceAxes::Tool, &rotation);
        let expected = coupled(m2, b2, k2);
        let [a, b] = [turned, expected].map(|i| i.matrices(&i.coupling.unwrap()));
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).norm() < 1e-5 * b.norm()), "{a:?} {b:?}");
        assert_eq!(turned.axes, ImpedanceAxes::Tool);
    }
}

#[test]
fn matrices_that_are_not_definite_are_named_with_the_pivot() {
    // Elements: (y, x), (z, x), (z, y), (about x, x), ...
    let with = |change: fn(&mut ImpedanceCoupling)| {
        let mut coupling = ImpedanceCoupling::NONE;
        change(&mut coupling);
        Impedance { coupling: Some(coupling), ..SOFT }.validate()
    };
    let refused = |change| with(change).unwrap_err().to_string();
    // 1.5 − 2²/1.5.
    assert_eq!(
        refused(|c| c.mass[0] = 2.0),
        "the mass matrix is not positive definite: its pivot along y is -1.1666667 kg; it must be at least 0.001 kg"
    );
    // 7.5 − 9²/7.5; 300 − 400²/300; with the tolerance for rounding on the diagonal.
    let said = refused(|c| c.damping[3] = 9.0);
    let expected = "the damping matrix is not positive semi-definite: its pivot about x is -3.29";
    assert!(said.starts_with(expected) && said.ends_with("N·m·s/rad; it must not be negative"), "{said}");
    let said = refused(|c| c.stiffness[2] = 400.0);
    let expected = "the stiffness matrix is not positive semi-definite: its pivot along z is -233.";
    assert!(said.starts_with(expected) && said.contains("N/m"), "{said}");
    let said = refused(|c| c.stiffness[14] = f32::NAN);
    assert!(said.contains("its pivot about z is NaN"), "{said}");
    // Semi-definite: a spring along the diagonal of x and y only.
    assert!(with(|c| c.stiffness[0] = 300.0).is_ok() && with(|c| c.damping[0] = -7.5).is_ok());
    // Too stiff for the mass in that direction only: 3600 instead of (1.5 − 0.8) · 2500 = 1750.
    let mut stiff = Impedance { stiffness: [1800.0; 6], ..SOFT };
    stiff.coupling = Some(ImpedanceCoupling { mass: [0.0; 15], damping: [0.0; 15], stiffness: [0.0; 15] });
    assert!(stiff.validate().is_ok());
    stiff.coupling.as_mut().unwrap().mass[0] = 0.8;
    let said = stiff.validate().unwrap_err().to_string();
    assert!(said.contains("the stiffness matrix is too large for this mass: 2500 times the mass"), "{said}");
}

#[test]
fn coupling_is_blended_in_and_vanishes_again() {
    let mut impedance = SOFT;
    let mut goal = Impedance { coupling: Some(ImpedanceCoupling::NONE), ..SOFT };
    goal.coupling.as_mut().unwrap().stiffness[0] = 200.0;
    impedance.blend_towards(&goal, 0.05);
    assert!((impedance.coupling.unwrap().stiffness[0] - 10.0).abs() < 1e-4);
    impedance = goal;
    let ticks = (0..1000).take_while(|_| {
        impedance.blend_towards(&SOFT, 0.05);
        impedance.coupling.is_some()
    });
    // 200 · 0.95ⁿ < 1e-5 · 300.
    assert_eq!(ticks.count(), 216);
}

#[test]
fn bad_numbers_are_named_with_axis_and_limit() {
    let with = |change: fn(&mut Impedance)| {
        let mut impedance = SOFT;
        change(&mut impedance);
        impedance.validate().unwrap_err().to_string()
    };
    assert_eq!(with(|i| i.mass[4] = 0.0), "the mass about y is 0 kg·m²; possible is 0.001 to 10000 kg·m²");
    assert_eq!(with(|i| i.mass[0] = f32::NAN), "the mass along x is NaN kg; possible is 0.001 to 10000 kg");
    assert_eq!(
        with(|i| i.damping[1] = -1.0),
        "the damping along y is -1 N·s/m; possible with this mass is 0 to 150 N·s/m"
    );
    assert_eq!(
        with(|i| i.stiffness[5] = 4000.0),
        "the stiffness about z is 4000 N·m/rad; possible with this mass is 0 to 3750 N·m/rad"
    );
    assert!(SOFT.validate().is_ok());
}

/// 1.5 kg, of which x lacks half, y nothing, and z a third.
#[test]
#[expect(clippy::float_cmp, reason = "the ratios are exact")]
fn masses_are_raised_with_their_damping() {
    let mut raised = SOFT;
    raised.raise_mass(&[3.0, 1.0, 2.0]);
    assert_eq!(raised.mass, [3.0, 1.5, 2.0, 1.5, 1.5, 1.5]);
    assert_eq!(raised.damping, [15.0, 7.5, 10.0, 7.5, 7.5, 7.5]);
    assert_eq!(raised.stiffness, SOFT.stiffness);
    // Coupled, all by the same ratio: the free mass of x is 1.5 − 0.5²/1.5 kg.
    let mut coupling = ImpedanceCoupling::NONE;
    (coupling.mass[0], coupling.damping[0]) = (0.5, 2.5);
    let mut raised = Impedance { coupling: Some(coupling), ..SOFT };
    let free = 1.5 - 0.25 / 1.5;
    assert!((raised.free_mass()[0] - free).abs() < 1e-5);
    raised.raise_mass(&[2.0 * free, 0.0, 0.0]);
    assert!((raised.free_mass()[0] - 2.0 * free).abs() < 1e-5, "{raised:?}");
    for (values, before) in [(raised.mass, SOFT.mass), (raised.damping, SOFT.damping)] {
        assert!(values.iter().zip(before).all(|(value, before)| (value / before - 2.0).abs() < 1e-5));
    }
    let coupling = raised.coupling.unwrap();
    assert!((coupling.mass[0] - 1.0).abs() < 1e-5 && (coupling.damping[0] - 5.0).abs() < 1e-5);
}
