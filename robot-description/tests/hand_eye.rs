//! `hand_eye.toml`: what is wrong with it is said in words, with the place.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use tesaki_description::hand_eye::{FILE, load};

const GOOD: &str = "\
rose = 0.04
tilt = 0.17
turn = 0.0
rows = [
  [13.2, 127.5, 111.5, 0.3],
  [23.6, 127.5, 124.4, 0.11],
  [37.4, 127.5, 141.6, 0.02],
]
";

#[test]
fn the_table_of_a_robot_is_read() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(FILE), GOOD).unwrap();
    let (center, radius) = load(folder.path()).unwrap().table.appearance(&[0.0, 0.0, 0.11], 0.04);
    assert!((radius - 23.6).abs() < 1e-3 && (center[1] - 124.4).abs() < 1e-3, "{center:?} {radius}");
    let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/knob-arm");
    load(&robot).unwrap();
}

#[test]
fn what_is_wrong_is_said_by_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE);
    let said = || load(folder.path()).unwrap_err().to_string();
    assert!(
        said().contains("hand_eye.toml") && said().contains("`tesaki calibrate camera` makes it"),
        "{}",
        said()
    );
    for (from, to, expected) in [
        ("rose = 0.04", "rose = 40.0", ":1: rose: the radius of the rose [m] is 40; it must be 0.005 to 0.5"),
        ("tilt = 0.17", "tilt = 10.0", ":2: tilt: the tilt [rad] is 10; it must be -1.2 to 1.2"),
        ("turn = 0.0", "turn = nan", ":3: turn: the turn [rad] is NaN; it must be -3.2 to 3.2"),
        ("turn = 0.0", "turn = \"left\"", ":3: invalid type: string \"left\""),
        ("turn = 0.0", "", ":1: missing field `turn`"),
        ("turn = 0.0", "turn = 0.0\nfocal = 140", ":4: unknown field `focal`"),
        ("[23.6, 127.5,", "[23.6, nan,", ":6: rows[1]: a centre [px] is NaN; it must be -4096 to 8192"),
        ("0.11]", "11.0]", ":6: rows[1]: a distance [m] is 11; it must be -1 to 10"),
        ("0.11]", "0.11, 5.0]", ":6: rows[1] has 5 numbers; it must have 4"),
        ("[37.4,", "[17.4,", ":7: rows[2]: from row to row the radius must grow and the distance shrink"),
        (
            "  [13.2, 127.5, 111.5, 0.3],\n  [23.6, 127.5, 124.4, 0.11],\n",
            "",
            ":4: rows has 1 entries; it must have 2",
        ),
    ] {
        assert!(GOOD.contains(from), "{from}");
        std::fs::write(&path, GOOD.replacen(from, to, 1)).unwrap();
        let said = said();
        let place = format!("{}{expected}", path.display());
        assert!(said.contains(&place), "{said} in place of {place}");
    }
}
