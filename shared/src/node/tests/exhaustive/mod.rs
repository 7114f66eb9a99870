//! Breadth-first search, on the real node, of all orders in which requests arrive, the emergency stop is
//! pressed and time passes: only the commander's newest message can enable the robot.
//!
//! The clients' messages may arrive late, in any order, any number of times or never. The content of a
//! message is chosen when it arrives for the first time; its position in the order of sending is its *slot*.

mod machine;
mod mutations;
mod recovery;
mod search;
mod specification;

use std::println;
use std::time::Instant;
use std::vec::Vec;

use machine::Word;
use mutations::Mutation;
use search::{Variation, Violation, search};
use specification::{COMMANDERS, Numbers};

use crate::model::Reaction;

/// Client numbers of the clients that may command.
const CLIENTS: [u32; COMMANDERS] = [11, 12];
/// A client that never says hello.
const STRANGER: u32 = 13;

const WORDS: &[Word] = &[
    Word::Take,
    Word::TakeByForce,
    Word::Release,
    Word::Enable,
    Word::Disable,
    Word::Stop,
    Word::Keep,
    Word::Clear(0),
];

/// Consecutive numbers.
const ORDINARY: Numbers = [1, 2, 3, 4, 5, 6];
/// Numbers that wrap around.
const WRAPPING: Numbers = [65_534, 65_535, 0, 1, 2, 3];
/// A client that sends many reads in between: a quarter of the number range passes after slot 1.
const FAR_APART: Numbers = [1, 2, 16_390, 16_391, 16_392, 16_393];

const BASE: Variation = Variation {
    name: "two commanders",
    slots: [3, 1],
    words: WORDS,
    numbers: ORDINARY,
    reaction: Reaction::Hold,
    emergency: true,
    resets: 0,
    faults: 1,
    twins: false,
    depth: usize::MAX,
};

const ALONE: Variation = Variation { name: "one commander", slots: [4, 0], emergency: false, ..BASE };

const OFF: Variation =
    Variation { name: "faults switch the outputs off", slots: [2, 1], reaction: Reaction::Off, ..BASE };

const WRAP: Variation =
    Variation { name: "numbers wrap around", slots: [2, 2], numbers: WRAPPING, emergency: false, ..BASE };

const FAR: Variation = Variation {
    name: "numbers far apart",
    slots: [3, 1],
    words: &[Word::TakeByForce, Word::Release, Word::Enable, Word::Disable, Word::Keep, Word::ReadStatus],
    numbers: FAR_APART,
    emergency: false,
    ..BASE
};

const RESET: Variation = Variation {
    name: "a reset",
    slots: [4, 0],
    words: &[Word::Hello, Word::Take, Word::TakeByForce, Word::Enable, Word::Disable],
    emergency: false,
    resets: 1,
    faults: 0,
    ..BASE
};

/// Tests the command timeout.
const TIMEOUT: Variation = Variation {
    name: "repetitions are no sign of life",
    slots: [4, 0],
    words: &[Word::Take, Word::Enable, Word::Keep],
    emergency: false,
    ..BASE
};

const TWINS: Variation =
    Variation { name: "two programs with one number", slots: [2, 1], twins: true, emergency: false, ..BASE };

/// The variation in which the mutations are searched.
const WIDE: Variation = Variation { slots: [3, 2], depth: 6, ..BASE };

/// Searches with the bounds of the variation, or with those in `TESAKI_SEARCH`: the numbers of messages of
/// the two commanders, of faults, and of events.
fn run(variation: &Variation) {
    let mut variation = *variation;
    if let Ok(bounds) = std::env::var("TESAKI_SEARCH") {
        let bounds: Vec<usize> = bounds.split_whitespace().map(|bound| bound.parse().unwrap()).collect();
        let &[first, second, faults, depth] = bounds.as_slice() else { panic!("four numbers: {bounds:?}") };
        variation.slots = [first as u8, second as u8];
        (variation.faults, variation.depth) = (faults as u8, depth);
    }
    let start = Instant::now();
    let figures = search(&variation, None);
    let figures = figures.unwrap_or_else(|violation| panic!("{}: {violation:?}", variation.name));
    assert!(figures.complete || variation.depth < usize::MAX);
    println!("{}: {figures:?}, {:.1} s", variation.name, start.elapsed().as_secs_f64());
}

#[test]
fn nothing_enables_without_the_newest_word_of_the_commander() {
    run(&BASE);
}

#[test]
fn a_commander_alone_enables_with_its_newest_word() {
    run(&ALONE);
}

#[test]
fn faults_that_switch_off_leave_the_outputs_off() {
    run(&OFF);
}

#[test]
fn wrapping_numbers_keep_their_order() {
    run(&WRAP);
}

#[test]
fn a_client_that_reads_a_quarter_of_all_numbers_loses_no_order() {
    run(&FAR);
}

#[test]
fn nothing_from_before_a_reset_enables_after_it() {
    run(&RESET);
}

#[test]
fn repetitions_do_not_keep_a_task_running() {
    run(&TIMEOUT);
}

#[test]
fn two_programs_with_one_client_number_execute_each_number_once() {
    run(&TWINS);
}

#[test]
fn the_search_finds_every_error_of_a_node() {
    for mutation in mutations::ALL {
        let variation = match mutation {
            Mutation::RemembersForTooLong | Mutation::AnswersForWhatItNeverExecuted => &FAR,
            Mutation::HelloOutdatesNothing | Mutation::ResetsNothing => &RESET,
            Mutation::RepeatedKeepCounts => &TIMEOUT,
            _ => &WIDE,
        };
        match search(variation, Some(mutation)) {
            Err(Violation { rule, path }) => println!("{mutation:?}: {rule}: {path:?}"),
            Ok(figures) => panic!("{mutation:?} not found: {figures:?}"),
        }
    }
}
