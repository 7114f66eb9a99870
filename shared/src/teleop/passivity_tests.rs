#![allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::unwrap_used,
    reason = "tests"
)]

use super::*;

const LIMITS: PowerPortLimits =
    PowerPortLimits { max_damping: 50.0, contact_damping: 0.0, energy_reserve: 0.0 };

/// Amplitude of a mass on a spring over a link with 60 ms of delay: unstable without the ports, passive
/// with them.
fn amplitude(passive: bool) -> f32 {
    let (mass, stiffness, delay) = (1.5_f32, 300.0_f32, 3);
    let (mut position, mut velocity) = (Vector3::new(0.02_f32, 0.0, 0.0), Vector3::zeros());
    let (mut forward, mut back) = (vec![(position, 0); delay], vec![(Vector3::zeros(), 0); delay]);
    let (mut master, mut slave, mut reference) = (PowerPort::new(), PowerPort::new(), Vector3::zeros());
    let mut largest = 0.0_f32;
    for tick in 0..1000 {
        let (target, received): (Vector3<f32>, i64) = forward.remove(0);
        // The slave's set-point compresses the spring.
        let displacement = target - reference;
        let displacement = if passive {
            slave.limit_displacement(&LIMITS, received, &(target * stiffness), &displacement)
        } else {
            displacement
        };
        let mean = (reference + displacement * 0.5) * stiffness;
        slave.account(&mean, &Vector3::zeros(), &displacement);
        reference += displacement;
        back.push((-reference * stiffness, slave.energy_in()));
        let (force, received) = back.remove(0);
        let damping = if passive {
            master.damping_force(&LIMITS, received, &force, &velocity)
        } else {
            Vector3::zeros()
        };
        let acceleration = (force + damping) / mass;
        let displacement = velocity * TICK + acceleration * (0.5 * TICK * TICK);
        master.account(&force, &damping, &displacement);
        position += displacement;
        velocity += acceleration * TICK;
        forward.push((position, master.energy_in()));
        if tick > 100 {
            largest = largest.max(position.norm());
        }
    }
    largest
}

#[test]
fn the_ports_make_a_delayed_spring_passive() {
    let (without, with) = (amplitude(false), amplitude(true));
    assert!(without > 1.0, "{without}");
    assert!(with < 0.03, "{with}");
}

/// Whether a handle of 100 kg on a spring of 1500 N/m, with the delay `round_trip` [s] and a zero-order hold,
/// comes to rest under a damping of 100 N·s/m. Simulated in steps of 0.1 ms. A heavy handle oscillates
/// slowly, where the condition is sharp.
fn comes_to_rest(round_trip: f64) -> bool {
    const STEP: f64 = 1e-4;
    let (mass, stiffness, damping) = (100.0, 1500.0, 100.0);
    let (mut positions, mut velocity, mut force) = (vec![0.01_f64], 0.0, 0.0);
    for step in 0..600_000_usize {
        if step % 100 == 0 {
            let late = (round_trip / STEP).round() as usize;
            force = -stiffness * positions[step.saturating_sub(late)];
        }
        velocity += STEP * (force - damping * velocity) / mass;
        positions.push(positions[step] + STEP * velocity);
    }
    let amplitude = |range: &[f64]| range.iter().fold(0.0_f64, |max, value| max.max(value.abs()));
    amplitude(&positions[500_000..]) < amplitude(&positions[..100_000])
}

#[test]
fn a_link_with_more_delay_than_the_damping_is_good_for_is_refused_with_the_one_that_would_do() {
    let limits = PowerPortLimits { max_damping: 100.0, contact_damping: 0.0, energy_reserve: 0.02 };
    // 100/300 s less 5 ms: 160 ms in each direction, but not 170 ms.
    assert_eq!(limits.check_link([1.5, 0.0], 300.0, 0.32), Ok(()));
    let UnsuitableLink::Delay { limit, stiffness, .. } =
        limits.check_link([1.5, 0.0], 300.0, 0.34).unwrap_err()
    else {
        panic!("not the delay");
    };
    assert!((limit - 0.328_333).abs() < 1e-5 && (stiffness - 289.855).abs() < 1e-2, "{limit} {stiffness}");
    assert_eq!(limits.check_link([1.5, 0.0], stiffness * 0.9999, 0.34), Ok(()));
    // With 20 N·s/m of its own: 120/300 s less 5 ms.
    assert_eq!(limits.check_link([1.5, 20.0], 300.0, 0.39), Ok(()));
    assert!(limits.check_link([1.5, 20.0], 300.0, 0.4).is_err());
    let told = limits.check_link([1.5, 0.0], 300.0, 0.34).unwrap_err().to_string();
    assert!(told.contains("takes 0.34 s there and back") && told.contains("at most 289."), "{told}");
    let heavy = limits.check_link([1.0, 0.0], 300.0, 0.0).unwrap_err();
    assert_eq!(heavy, UnsuitableLink::Damping { value: 100.0, limit: 100.0 });
    for (mass, stiffness, delay) in [(0.0, 1.0, 0.0), (1.5, f32::NAN, 0.0), (1.5, 1.0, -0.1)] {
        assert_eq!(limits.check_link([mass, 0.0], stiffness, delay), Err(UnsuitableLink::Invalid));
    }
    let stiff = limits.check_link([1.5, 0.0], 30_000.0, 0.0).unwrap_err().to_string();
    assert!(stiff.contains("even without delay"), "{stiff}");
}

#[test]
fn the_condition_separates_handles_that_rest_from_those_that_swing() {
    // 100/1500 s less 5 ms: 61.7 ms.
    assert!(comes_to_rest(0.055) && !comes_to_rest(0.068));
}

/// Residual amplitude of a handle [m], two to three seconds after a person (1.5 kg, 15 N·s/m, 300 N/m) has
/// pressed it 3 cm into a spring of 300 N/m with a delay of 100 ms, over ports with a reserve of 20 mJ. The
/// port at the spring always has enough energy: only the port at the handle limits.
fn swings_in_contact(limits: &PowerPortLimits) -> f32 {
    let still = Vector3::zeros();
    let [mut master, mut slave] = [PowerPort::new(); 2];
    let [mut position, mut velocity, mut force, mut reference] = [still; 4];
    let mut late = [(still, 0_i64); 5].to_vec();
    let mut back = late.clone();
    let [mut least, mut most] = [f32::MAX, f32::MIN];
    for tick in 0..400 {
        late.push((position, master.energy_in()));
        let (target, _) = late.remove(0);
        slave.account(&((target + reference) * 150.0), &still, &(target - reference));
        reference = target;
        back.push((reference * -300.0, slave.energy_in()));
        let (pushed, received) = back.remove(0);
        force.copy_from(&pushed);
        let damping = master.damping_force(limits, received, &force, &velocity);
        let operator = (Vector3::new(0.03, 0.0, 0.0) - position) * 300.0 - velocity * 15.0;
        let acceleration = (force + damping + operator) / 1.5;
        let displacement = velocity * TICK + acceleration * (0.5 * TICK * TICK);
        master.account(&force, &damping, &displacement);
        position += displacement;
        velocity += acceleration * TICK;
        if (200..300).contains(&tick) {
            (least, most) = (least.min(position.x), most.max(position.x));
        }
    }
    most - least
}

#[test]
fn a_handle_in_contact_comes_to_rest_before_the_reserve_is_used_up() {
    let reserve = PowerPortLimits { max_damping: 100.0, contact_damping: 0.0, energy_reserve: 0.02 };
    // 300 N/m times 105 ms, less its own 15 N·s/m; 0 for a handle with more damping, and at most the limit.
    let calm = reserve.calm(15.0, 300.0, 0.1);
    assert!((calm.contact_damping - 16.5).abs() < 1e-4, "{calm:?}");
    assert!(reserve.calm(60.0, 300.0, 0.1).contact_damping.abs() < f32::EPSILON);
    assert!((reserve.calm(0.0, 300.0, 1.0).contact_damping - 100.0).abs() < f32::EPSILON);
    let [swinging, calm] = [reserve, calm].map(|limits| swings_in_contact(&limits));
    assert!(swinging > 1e-2 && calm < 1e-3, "{swinging} {calm}");
}

#[test]
fn contact_damps_the_handle_and_free_motion_does_not() {
    let limits = PowerPortLimits { max_damping: 100.0, contact_damping: 20.0, energy_reserve: 1.0 };
    let (port, velocity) = (PowerPort::new(), Vector3::new(0.1, 0.0, 0.0));
    let damping =
        |force: f32, velocity| port.damping_force(&limits, 0, &Vector3::new(force, 0.0, 0.0), velocity).x;
    assert!((damping(-3.0, &velocity) + 2.0).abs() < 1e-6);
    assert!(damping(0.0, &velocity).abs() < f32::EPSILON);
    // At rest there is only noise.
    assert!(damping(-3.0, &(velocity * 5e-4)).abs() < f32::EPSILON);
}

#[test]
fn the_output_is_limited_to_the_input_at_the_other_end() {
    let mut port = PowerPort::new();
    let (force, displacement) = (Vector3::new(2.0, 0.0, 0.0), Vector3::new(0.01, 0.0, 0.0));
    // 20 mJ requested, 5 mJ entered at the other end.
    let half = port.limit_displacement(&LIMITS, 5000, &force, &displacement);
    assert!((half.x - 0.0025).abs() < 1e-8);
    port.account(&force, &Vector3::zeros(), &half);
    assert!(port.limit_displacement(&LIMITS, 5000, &force, &displacement).norm() < 1e-8);
    // The opposite displacement is an input and not limited.
    assert_eq!(port.limit_displacement(&LIMITS, 5000, &force, &-displacement), -displacement);
    port.account(&force, &Vector3::zeros(), &-displacement);
    assert!((port.energy_in() - 20_000).abs() <= 1 && (port.balance() - 15_000).abs() <= 1, "{port:?}");
}

#[test]
fn a_millijoule_counts_after_megajoules() {
    let (mut one, mut other) = (PowerPort::new(), PowerPort::new());
    let (force, still) = (Vector3::new(1.0, 0.0, 0.0), Vector3::zeros());
    // 2 kW for ten seconds, or 3 W for two hours.
    for _ in 0..20_000 {
        one.account(&force, &still, &-force);
        other.account(&force, &still, &force);
    }
    let piece = force * 1.1e-3;
    (0..1000).for_each(|_| one.account(&force, &still, &-piece));
    let displacement = other.limit_displacement(&LIMITS, one.energy_in(), &force, &(force * 10.0));
    assert!((displacement.x - 1.1).abs() < 2e-3, "{displacement}");
    // Also the dissipated energy.
    (0..1000).for_each(|_| one.account(&still, &-force, &piece));
    let damped = one.balance() - one.energy_in();
    assert!((damped - 1_100_000).abs() < 100, "{damped}");
}

/// Random numbers from 0 to 1.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 40) as f32) / (1_u32 << 24) as f32
    }
}

/// A direction of a link: constant delay, jitter that reorders, and loss.
struct Line<M> {
    delay: f32,
    jitter: f32,
    transit: Vec<(usize, M)>,
}

impl<M: Copy> Line<M> {
    /// Up to 100 ms late, with a jitter of up to 50 ms.
    fn random(draws: &mut Draws) -> Self {
        Self { delay: 0.1 * draws.next(), jitter: 0.05 * draws.next(), transit: Vec::new() }
    }

    fn pass(&mut self, draws: &mut Draws, tick: usize, message: M, mut deliver: impl FnMut(M)) {
        let late = (self.delay + self.jitter * draws.next()) / TICK;
        if draws.next() >= 0.2 {
            self.transit.push((tick + late as usize, message));
        }
        self.transit.retain(|&(due, message)| {
            if due <= tick {
                deliver(message);
            }
            due > tick
        });
    }
}

/// A person repeatedly presses the slave's spring against a wall and withdraws, over a link with 20 % loss.
/// In every sample the energy that has left at the slave is at most the energy that had entered at the master
/// plus the reserve.
fn press(seed: u64) {
    let mut draws = Draws(seed);
    // With and without damping in contact.
    let contact_damping = 100.0 * draws.next() * ((seed % 2) as f32);
    let limits = PowerPortLimits { max_damping: 100.0, contact_damping, energy_reserve: 0.02 };
    // 50 to 50 000 N/m, logarithmically uniform.
    let wall = 50.0 * math::exp(6.907_755 * draws.next());
    let mut forward = Line::random(&mut draws);
    let mut back = Line::random(&mut draws);
    let stiffness = 300.0 * wall / (300.0 + wall);
    let (mut master, mut slave) = (PowerPort::new(), PowerPort::new());
    let [mut position, mut velocity, mut force, mut reference, mut target] = [Vector3::<f32>::zeros(); 5];
    let (mut from_master, mut from_slave) = (0_i64, 0_i64);
    let push = |reference: &Vector3<f32>| {
        let depth = reference.x - 0.02;
        Vector3::new(if depth > 0.0 { depth * stiffness } else { 0.0 }, 0.0, 0.0)
    };
    // Energies in double precision, apart from the ports' own counts [J].
    let (mut entered, mut left) = (0.0_f64, 0.0_f64);
    for tick in 0..2000 {
        forward.pass(&mut draws, tick, (position, master.energy_in()), |(pose, energy)| {
            // The last pose to arrive; the largest energy.
            target = pose;
            from_master = from_master.max(energy);
        });
        let desired = target - reference;
        let displacement =
            slave.limit_displacement(&limits, from_master, &push(&(reference + desired)), &desired);
        // A spring beyond a gap: the work of the end's force over the displacement is an upper bound.
        let ends = push(&(reference + displacement));
        let (begin, length) = (push(&reference), displacement.norm());
        let mean = if length > 0.0 {
            let [a, b] = [&begin, &ends].map(|force| f64::from(force.x));
            let work = (b * b - a * a) / (2.0 * f64::from(stiffness));
            left += work;
            Vector3::new((work / f64::from(displacement.x)) as f32, 0.0, 0.0)
        } else {
            begin
        };
        slave.account(&mean, &Vector3::zeros(), &displacement);
        reference += displacement;
        assert!(
            left <= entered + 0.02 + 2e-3,
            "seed {seed}, tick {tick}: {left} J left, {entered} J had entered, wall {wall} N/m"
        );
        back.pass(&mut draws, tick, (-push(&reference), slave.energy_in()), |(pushed, energy)| {
            force = pushed;
            from_slave = from_slave.max(energy);
        });
        let damping = master.damping_force(&limits, from_slave, &force, &velocity);
        // The operator: 300 N/m, 15 N·s/m, 1.5 kg; forwards for a second, back for another.
        let goal = Vector3::new(if tick % 200 < 100 { 0.05 } else { 0.0 }, 0.0, 0.0);
        let operator = (goal - position) * 300.0 - velocity * 15.0;
        let acceleration = (force + damping + operator) / 1.5;
        let displacement = velocity * TICK + acceleration * (0.5 * TICK * TICK);
        master.account(&force, &damping, &displacement);
        let work = f64::from(-force.dot(&displacement));
        entered += if work > 0.0 { work } else { 0.0 };
        position += displacement;
        velocity += acceleration * TICK;
    }
}

#[test]
fn a_slave_never_gives_more_than_entered_at_the_master() {
    (1..=500).for_each(press);
}
