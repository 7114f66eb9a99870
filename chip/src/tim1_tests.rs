use super::*;

const CLOCK: u64 = 168_000_000;

/// Returns a timer that is centre-aligned at 20 kHz, with a duty of a quarter on channel 1 and its pulse
/// around the underflow.
fn pulses(main: bool) -> Tim1 {
    let mut timer = Tim1::new();
    let writes = [
        (0x00, 0xA0),
        (0x04, 7 << 4),
        (0x2C, 4200),
        (0x18, 0x6868),
        (0x1C, 0x7868),
        (0x34, 1050),
        (0x40, 4199),
        (0x20, if main { 0x1005 } else { 0x1004 }),
        (0x14, 1),
        (0x44, 0x9400 | BKE),
        (0x00, 0xA1),
    ];
    for (offset, value) in writes {
        timer.write(offset, value, 0, CLOCK);
    }
    timer
}

/// By hand: a period is 50 µs; the pulse lasts from 6.25 µs before the underflow to 6.25 µs after it.
#[test]
fn a_pulse_lies_around_the_underflow() {
    let timer = pulses(false);
    let at = |microseconds: f64| timer.complementary(0, (microseconds * 1e6) as u64, CLOCK);
    for (time, level) in [(1.0, Level::High), (6.2, Level::High), (6.3, Level::Low), (43.7, Level::Low)] {
        assert_eq!(at(time), level, "{time}");
    }
    assert_eq!(at(43.8), Level::High);
    assert_eq!(pulses(true).complementary(0, 1_000_000, CLOCK), Level::Low, "the complement");
}

/// By hand: a quarter of 50 µs up to the middle of the way, and as much later down.
#[test]
fn the_direction_tells_the_ways_up_and_down_apart() {
    let timer = pulses(false);
    for (time, count, goes_down) in [(12_500_000, 2100, false), (37_500_000, 2100, true)] {
        let direction = timer.read(0x00, time, CLOCK).unwrap() >> 4 & 1;
        assert_eq!((timer.read(0x24, time, CLOCK), direction == 1), (Some(count), goes_down));
    }
}

/// By hand: a pair of outputs with 20 ticks of 5.952 ns, 0.119 µs, between them.
#[test]
fn outputs_of_a_pair_are_never_on_together() {
    let mut timer = pulses(true);
    timer.write(0x44, 0x8400 | 20, 0, CLOCK);
    let at = |microseconds: f64| timer.outputs(0, (microseconds * 1e6) as u64, CLOCK);
    let (low, high) = (Level::Low, Level::High);
    for (time, levels) in [
        (6.2, [high, low]),
        (6.3, [low, low]),
        (6.4, [low, high]),
        (43.7, [low, high]),
        (43.8, [low, low]),
        (43.9, [high, low]),
    ] {
        assert_eq!(at(time), levels, "{time}");
    }
    let mut edges = Vec::new();
    while edges.len() < 5 {
        edges.push(timer.next_edge(edges.last().copied().unwrap_or(1_000_000), CLOCK));
    }
    let edges: Vec<f64> = edges.into_iter().map(|edge| edge as f64 * 1e-6).collect();
    for (edge, expected) in edges.iter().zip([6.25, 6.369, 25.0, 43.756, 43.875]) {
        assert!((edge - expected).abs() < 0.01, "{edges:?}");
    }
}

/// A pulse that is shorter than the dead time is suppressed, and one that begins within it is delayed.
#[test]
fn short_and_changed_pulses_keep_the_dead_time() {
    let mut timer = pulses(true);
    timer.write(0x44, 0x8400 | 20, 0, CLOCK);
    timer.write(0x34, 5, 0, CLOCK);
    let both = |timer: &Tim1, time: u64| timer.outputs(0, time, CLOCK);
    let (low, high) = (Level::Low, Level::High);
    timer.advance(60_000_000, CLOCK);
    // The pulse lasts 30 ns on both sides of 100 µs.
    for (time, levels) in
        [(99_900, [low, high]), (99_980, [low, low]), (100_100, [low, low]), (100_160, [low, high])]
    {
        assert_eq!(both(&timer, time * 1000), levels, "{time}");
    }
    timer.write(0x34, 0, 60_000_000, CLOCK);
    timer.advance(101_000_000, CLOCK);
    // From the top on without a pulse, and a long one from the middle of the next on.
    timer.write(0x34, 1050, 130_000_000, CLOCK);
    timer.advance(150_010_000, CLOCK);
    assert_eq!(timer.next_edge(150_010_000, CLOCK), 150_010_000 + 20 * SECOND / CLOCK);
    for (time, levels) in [(150_010, [low, low]), (150_110, [low, low]), (150_130, [high, low])] {
        assert_eq!(both(&timer, time * 1000), levels, "{time}");
    }
    // A pulse of 12 ticks becomes a long one in its middle: the low side went off 12 ticks before.
    timer.write(0x34, 12, 151_000_000, CLOCK);
    timer.advance(180_000_000, CLOCK);
    timer.write(0x34, 1050, 190_000_000, CLOCK);
    timer.advance(200_003_000, CLOCK);
    for (time, levels) in [(200_003, [low, low]), (200_045, [low, low]), (200_060, [high, low])] {
        assert_eq!(both(&timer, time * 1000), levels, "{time}");
    }
}

#[test]
fn the_trigger_comes_once_a_period_just_before_the_top() {
    let mut timer = pulses(false);
    let mut rising = Vec::new();
    while rising.len() < 3 {
        let now = timer.next(CLOCK);
        timer.advance(now, CLOCK);
        let [event, output] = timer.take_triggers();
        assert_eq!(event, output, "with the main output enabled");
        if output.0 {
            rising.push(now as f64 * 1e-6);
        }
    }
    // 4199 of 4200 counts of 5.952 ns.
    for (time, expected) in rising.into_iter().zip([24.994, 74.994, 124.994]) {
        assert!((time - expected).abs() < 0.001, "{time}");
    }
}

#[test]
fn without_the_main_output_only_the_trigger_output_triggers() {
    let mut timer = pulses(false);
    timer.write(0x44, 0x1400 | BKE, 0, CLOCK);
    let mut triggers = [(false, false); 2];
    for _ in 0..8 {
        timer.advance(timer.next(CLOCK), CLOCK);
        for (all, [rises, falls]) in triggers.iter_mut().zip(timer.take_triggers().map(<[bool; 2]>::from)) {
            *all = (all.0 || rises, all.1 || falls);
        }
    }
    assert_eq!(triggers, [(false, false), (true, true)]);
}

#[test]
fn a_break_stops_until_software_starts_again_unless_aoe_is_set() {
    for aoe in [0, AOE] {
        let mut timer = pulses(false);
        timer.write(0x44, 0x9400 | BKE | aoe, 0, CLOCK);
        timer.set_break_input(Some(false));
        assert_eq!(timer.complementary(0, 1_000_000, CLOCK), Level::Low);
        timer.write(0x44, 0x9400 | BKE | aoe, 2_000_000, CLOCK);
        assert_eq!(timer.complementary(0, 2_000_000, CLOCK), Level::Low, "still active");
        timer.set_break_input(Some(true));
        let later = 201_000_000;
        timer.advance(later, CLOCK);
        let expected = if aoe == 0 { Level::Low } else { Level::High };
        assert_eq!(timer.complementary(0, later, CLOCK), expected);
        timer.write(0x44, 0x9400 | BKE | aoe, later, CLOCK);
        assert_eq!(timer.complementary(0, later, CLOCK), Level::High);
    }
}

#[test]
fn the_lock_keeps_polarity_and_aoe() {
    let mut timer = Tim1::new();
    timer.write(0x44, 0x100 | BKE | OSSI, 0, CLOCK);
    timer.write(0x44, MOE | AOE | BKP | OSSI, 0, CLOCK);
    assert_eq!(timer.read(0x44, 0, CLOCK), Some(0x100 | BKE | OSSI | MOE));
}
