//! Damaged files of the simulator: recorded motions of an operator's hand, and objects.

use tesaki_sim::operator::Recorded;
use tesaki_sim::plant::ObjectValues;
use tesaki_tests::robot_folder;

use super::random::Random;

/// Files of each kind; the same ones each time.
const RUNS: u64 = 3000;

/// What is put into files.
const WORDS: &[&str] = &[
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "-0",
    "0",
    ",",
    "\n",
    "\r\n",
    "\"",
    "=",
    "[",
    "]",
    "{",
    "top = 0.5",
    "shape = \"wedge\"",
    "shape = \"cylinder\"",
    "#",
    "\u{feff}",
    "é",
    "9999999999999999999999",
];

/// `text` with some of its pieces removed, repeated or replaced.
fn damaged(random: &mut Random, text: &str) -> String {
    let mut chars: Vec<char> = text.chars().collect();
    for _ in 0..1 + random.below(4) {
        let start = random.below(chars.len() + 1);
        let end = chars.len().min(start + random.below(12));
        let piece: Vec<char> = match random.below(4) {
            0 => Vec::new(),
            1 => chars[start..end].repeat(2),
            2 => (0..random.below(4)).map(|_| char::from(random.below(128) as u8)).collect(),
            _ => WORDS[random.below(WORDS.len())].chars().collect(),
        };
        chars.splice(start..end, piece);
    }
    chars.into_iter().collect()
}

#[test]
fn a_damaged_motion_is_refused_or_has_finite_poses() {
    let mut good = "time,x,y,z,qx,qy,qz,qw\n".to_owned();
    for n in 0..6 {
        good += &format!("{n}.5,0.{n},0,-1e-1,0,0,0.{n},1\n");
    }
    assert!(Recorded::from_csv(&good).is_ok());
    let mut accepted = 0;
    for seed in 0..RUNS {
        let text = damaged(&mut Random(seed), &good);
        match Recorded::from_csv(&text) {
            Ok(motion) => {
                accepted += 1;
                assert!(motion.duration() > 0.0, "seed {seed}: {text}");
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
    assert!((1..RUNS).contains(&accepted), "{accepted}");
}

#[test]
fn a_damaged_object_is_refused_or_valid() {
    let mut accepted = 0;
    for name in ["box", "cylinder", "wedge"] {
        let file = robot_folder("hand3").join("objects").join(name).with_extension("toml");
        let good = std::fs::read_to_string(file).unwrap();
        assert!(ObjectValues::from_toml(&good).is_ok());
        for seed in 0..RUNS / 3 {
            match ObjectValues::from_toml(&damaged(&mut Random(seed), &good)) {
                Ok(object) => {
                    accepted += 1;
                    assert!(object.mass > 0.0 && object.mass.is_finite(), "{name}, seed {seed}: {object:?}");
                    assert!(
                        object.size.iter().all(|size| size.is_finite() && *size > 0.0),
                        "{name}, seed {seed}"
                    );
                }
                Err(error) => assert!(!error.to_string().is_empty()),
            }
        }
    }
    assert!((1..RUNS).contains(&accepted), "{accepted}");
}
