//! `tesaki retarget` on public hands.

use std::io::Write as _;
use std::process::Stdio;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tesaki::teleop::HumanFinger;
use tesaki_sim::plant::{Plant, PlantOptions};

use super::feed::feed;
use super::server::{Server, finish, said};

/// A public hand.
struct PublicHand {
    /// Its folder.
    robot: &'static str,
    /// Fingertips of an operator, and relative to the thumb those of the robot that reproduces them, by
    /// Pinocchio.
    table: &'static str,
    /// Number of joints with a motor, of fingers, and of those that can touch the thumb.
    joints: usize,
    fingers: usize,
    pinching: usize,
    /// Distance of touching tips [m].
    contact: f64,
    /// Minimum number of fingers that miss their targets when all these are 1.4 times as far away.
    missed: usize,
}

const HANDS: [PublicHand; 3] = [
    PublicHand {
        robot: "allegro",
        table: include_str!("../../oracles/data/allegro_tips.csv"),
        joints: 16,
        fingers: 4,
        pinching: 3,
        contact: 0.024,
        missed: 3,
    },
    PublicHand {
        robot: "leap",
        table: include_str!("../../oracles/data/leap_tips.csv"),
        joints: 16,
        fingers: 4,
        pinching: 3,
        contact: 0.02,
        missed: 3,
    },
    // Some finger joints follow others: six motors.
    PublicHand {
        robot: "inspire",
        table: include_str!("../../oracles/data/inspire_tips.csv"),
        joints: 6,
        fingers: 5,
        pinching: 2,
        contact: 0.02,
        missed: 4,
    },
];

/// Runs the command; returns exit code, standard output and standard error.
fn run(robot: &str, arguments: &[&str], input: &str) -> (i32, String, String) {
    let mut command = tesaki_tests::tesaki();
    command.arg("retarget").arg("--robot").arg(tesaki_tests::robot_folder(robot)).args(["--in", "-"]);
    feed(command.args(arguments), input)
}

/// Returns the numbers of a table, row by row.
fn rows(text: &str) -> Vec<Vec<f64>> {
    let row = |line: &str| line.split(',').map(|cell| cell.parse().unwrap()).collect();
    text.lines().skip(1).map(row).collect()
}

/// Returns the fingertips relative to the thumb's [m], computed with the simulator's bodies.
fn vectors(robot: &str, angles: &[f64]) -> Vec<f64> {
    let folder = tesaki_tests::robot(robot);
    let options = PlantOptions { posture: Some(angles.to_vec()), ..PlantOptions::exact() };
    let plant = Plant::of(&folder, &options).unwrap();
    let tips: Vec<[f64; 3]> = plant.tips().into_iter().map(|tip| tip.position).collect();
    tips.iter().flat_map(|tip| [0, 1, 2].map(|axis| tip[axis] - tips[0][axis])).collect()
}

fn length(vector: &[f64]) -> f64 {
    vector.iter().map(|x| x * x).sum::<f64>().sqrt()
}

#[test]
fn the_folders_of_public_hands_are_good() {
    for PublicHand { robot, joints, fingers, .. } in HANDS {
        let folder = tesaki_tests::robot_folder(robot);
        let (code, out, error) =
            feed(tesaki_tests::tesaki().args(["model", "check", folder.to_str().unwrap()]), "");
        let counted =
            out.contains(&format!(": {joints} joints ")) && out.contains(&format!(" in {fingers} chains"));
        assert!(code == 0 && !out.contains("BAD") && counted, "{out}{error}");
    }
}

/// The vectors match those of the hand for which they were made, also when thumb and finger touch; joints
/// stay within their limits.
#[test]
fn public_hands_reproduce_vectors_and_pinch() {
    for PublicHand { robot, table, fingers, pinching, contact, .. } in HANDS {
        let (code, out, error) = run(robot, &["--bandwidth", "20"], table);
        assert_eq!(code, 0, "{error}");
        let frames = rows(table).len();
        assert!(
            error.contains(&format!("{frames} frames"))
                && error.contains("computing time of a frame: median"),
            "{error}"
        );
        let folder = tesaki_tests::robot(robot);
        let (found, expected) = (rows(&out), rows(table));
        assert_eq!(found.len(), expected.len());
        let (mut within, mut pinched) = (0, vec![f64::INFINITY; pinching]);
        for (frame, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let angles = &found[1..];
            for (angle, joint) in angles.iter().zip(&folder.model.joints) {
                let (lower, upper) = (f64::from(joint.limits.lower), f64::from(joint.limits.upper));
                assert!(*angle >= lower - 1e-6 && *angle <= upper + 1e-6, "{robot} {frame} {}", joint.name);
            }
            let found = vectors(robot, angles);
            let expected = &expected[1 + 3 * fingers..];
            let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            // Close to the contact the direction follows the operator's with a delay.
            let is_near =
                (1..fingers).any(|finger| length(&expected[3 * finger..3 * finger + 3]) < 1.5 * contact);
            within += usize::from(worst < if is_near { 0.1 * contact } else { 5e-4 });
            for (finger, smallest) in (1..).zip(&mut pinched) {
                let [one, other] =
                    [&found[..], expected].map(|tips| length(&tips[3 * finger..3 * finger + 3]));
                // In a pinch the gap has the largest weight.
                assert!(
                    other > contact + 5e-3 || (one - other).abs() < 5e-4,
                    "{robot} {frame}: {one}, {other} m"
                );
                *smallest = smallest.min(one);
            }
        }
        // The speed limit delays a few frames after the start.
        assert!(within >= frames - 3, "{robot}: {within} frames");
        assert!(pinched.iter().all(|gap| (gap - contact).abs() < 5e-4), "{robot}: {pinched:?}");
    }
}

/// The Allegro hand in a frame with permuted axes, 0.37 m away.
#[test]
fn a_hand_whose_base_has_other_axes_moves_alike() {
    let [PublicHand { robot, table, fingers, .. }, ..] = HANDS;
    let (from, turned) = (tesaki_tests::robot_folder(robot), tempfile::tempdir().unwrap());
    for name in ["robot.urdf", "controller.toml", "plant.toml", "retargeting.toml"] {
        let base = "<link name=\"palm_link\">";
        let joint = "<link name=\"turned\"/><joint name=\"turn\" type=\"fixed\"><parent link=\"turned\"/><child \
            link=\"palm_link\"/><origin xyz=\"0.1 -0.2 0.3\" rpy=\"1.5707963 0 1.5707963\"/></joint>";
        let text = std::fs::read_to_string(from.join(name)).unwrap();
        let text = text.replacen(base, &format!("{joint}{base}"), 1);
        let text = text.replacen("rotation = [0.0, 0.0, 0.0]", "rotation = [1.5707963, 0.0, 1.5707963]", 1);
        std::fs::write(turned.path().join(name), text).unwrap();
    }
    let path = turned.path().to_str().unwrap();
    let (code, out, error) = run(path, &["--bandwidth", "20"], table);
    assert_eq!(code, 0, "{error}");
    let (found, expected) = (rows(&out), rows(table));
    let alike = |(found, expected): (&Vec<f64>, &Vec<f64>)| {
        let (tips, expected) = (vectors(path, &found[1..]), &expected[1 + 3 * fingers..]);
        tips.chunks(3).zip(expected.chunks(3)).all(|(a, b)| (length(a) - length(b)).abs() < 5e-4)
    };
    let count = found.iter().zip(&expected).filter(|&rows| alike(rows)).count();
    assert!(count >= expected.len() - 3, "{count} frames");
}

/// An operator whose fingers are too long for the robot.
#[test]
fn what_public_hands_cannot_reach_is_told() {
    for PublicHand { robot, table, fingers, missed, .. } in HANDS {
        let mut lines = table.lines();
        let mut far = lines.next().unwrap().to_owned() + "\n";
        for line in lines {
            let mut cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            for index in 4..1 + 3 * fingers {
                let thumb = cells[1 + (index - 1) % 3];
                cells[index] = thumb + 1.4 * (cells[index] - thumb);
            }
            far += &(cells.iter().map(f64::to_string).collect::<Vec<_>>().join(",") + "\n");
        }
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("joints.csv");
        let (code, said, error) = run(robot, &["--json", "--out", out.to_str().unwrap()], &far);
        assert_eq!(code, 0, "{error}");
        let value: Value = serde_json::from_str(&said).unwrap();
        let fingers = value["fingers"].as_object().unwrap();
        // The thumb reaches its targets.
        let far = fingers.values().filter(|finger| finger["within_tolerance"].as_f64().unwrap() < 0.9);
        assert!(far.count() >= missed, "{robot}: {said}");
    }
}

#[test]
fn public_hands_follow_on_a_board() {
    for PublicHand { robot, table, fingers, .. } in HANDS {
        let folder = tesaki_tests::robot_folder(robot);
        let options = PlantOptions::mismatched(1);
        let server = Server::start_robot(&folder, tempfile::tempdir().unwrap(), &options);
        server.succeeds(&["model", "push", folder.to_str().unwrap()]);
        server.home();
        let mut command = server.command(&["--json", "retarget", "--live", "--no-hold", "--robot"]);
        let mut child = command
            .arg(folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stdin = child.stdin.take().unwrap();
        let begin = Instant::now();
        for row in rows(table).iter().take(90) {
            let mut line = json!({ "time": begin.elapsed().as_secs_f64(), "tips": { "little": null } });
            for (finger, tip) in HumanFinger::ALL.into_iter().zip(row[1..1 + 3 * fingers].chunks(3)) {
                line["tips"][finger.name()] = json!(tip);
            }
            // If the program ends early, its output is checked below.
            let _ = writeln!(stdin, "{line}");
            std::thread::sleep(Duration::from_millis(33));
        }
        drop(stdin);
        let (code, out) = said(&finish(child));
        assert_eq!(code, 0, "{robot}: {out}");
        let objects: Vec<Value> = out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let (last, reports) = objects.split_last().unwrap();
        assert_eq!((&last["frames"], &last["dropped"]), (&json!(90), &json!(0)), "{out}");
        // A busy machine sends only the newest.
        assert!(reports.last().unwrap()["samples"].as_u64().unwrap() > 10, "{out}");
    }
}
