//! `tesaki eval grip` against cvxpy's answers and grasps worked by hand, and what it says about tables that
//! do not fit.
#![cfg(all(unix, feature = "cli"))]
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use std::collections::BTreeMap;

use common::{columns, tesaki};
use nalgebra::{Vector3, Vector6};

type StoredContact = ([f32; 3], [f32; 3], f32, f32);
/// Margin, least normal force, load; contacts as place, normal, friction, limit; half the least sum of
/// squares, if the load can be held; whether it is on the boundary of what can (`tests/oracles/grip.py`).
type Stored = (f32, f32, [f32; 6], &'static [StoredContact], Option<f32>, bool);

const STORED: &[Stored] = include!("../../tests/oracles/data/grip.in");

/// Two fingers that face each other along x, 40 mm apart.
const PINCH: &str = "x1,y1,z1,nx1,ny1,nz1,mu1,max1,x2,y2,z2,nx2,ny2,nz2,mu2,max2,fx,fy,fz\n";

type Columns = BTreeMap<String, Vec<String>>;

#[track_caller]
fn grip(more: &[&str], input: &str) -> (Columns, String) {
    let (code, out, err) = tesaki(&[&["eval", "grip", "--in", "-"], more].concat(), input);
    assert_eq!(code, 0, "{err}");
    (columns(&out), err)
}

fn number(columns: &Columns, name: &str, row: usize) -> f64 {
    let text = &columns[name][row];
    text.parse().unwrap_or_else(|_| panic!("{name}, row {row}: {text:?}"))
}

fn vector(columns: &Columns, names: [&str; 3], row: usize) -> Vector3<f64> {
    Vector3::from(names.map(|name| number(columns, name, row)))
}

/// Asserts that the columns have the values.
#[track_caller]
fn has(columns: &Columns, row: usize, values: &[(&str, f64)]) {
    for &(name, expected) in values {
        let got = number(columns, name, row);
        assert!((got - expected).abs() < 2e-6, "{name}, row {row}: {got} instead of {expected}");
    }
}

/// The stored cases as a table, all with six contacts, of which some are empty.
fn table(cases: &[&Stored]) -> String {
    let parts = ["x", "y", "z", "nx", "ny", "nz", "mu", "max"];
    let header = (1..=6).flat_map(|number| parts.map(|part| format!("{part}{number}")));
    let header = header.chain(["fx", "fy", "fz", "mx", "my", "mz"].map(str::to_owned));
    let mut lines = vec![header.collect::<Vec<_>>().join(",")];
    for (_, _, load, contacts, _, _) in cases {
        let mut cells = Vec::new();
        for (place, normal, friction, limit) in *contacts {
            cells.extend(
                place.iter().chain(normal).chain([friction, limit]).map(|value| format!("{value:?}")),
            );
        }
        cells.resize(6 * parts.len(), String::new());
        cells.extend(load.iter().map(|value| format!("{value:?}")));
        lines.push(cells.join(","));
    }
    lines.join("\n") + "\n"
}

/// A stored case in double precision, about the contacts' centroid.
struct Exact {
    margin: f64,
    least: f64,
    force: Vector3<f64>,
    moment: Vector3<f64>,
    /// Arm from the centroid, unit normal, friction, limit.
    contacts: Vec<(Vector3<f64>, Vector3<f64>, f64, f64)>,
    length: f64,
}

impl Exact {
    fn new((margin, least, load, contacts, ..): &Stored) -> Self {
        let place = |contact: &StoredContact| Vector3::from(contact.0).cast::<f64>();
        let share = 1.0 / contacts.iter().map(|_| 1.0).sum::<f64>();
        let center = contacts.iter().map(place).sum::<Vector3<f64>>() * share;
        let load = Vector6::from(*load).cast::<f64>();
        let force = Vector3::new(load[0], load[1], load[2]);
        let arms = contacts.iter().map(|contact| (place(contact) - center).norm_squared());
        Self {
            margin: f64::from(*margin),
            least: f64::from(*least),
            moment: Vector3::new(load[3], load[4], load[5]) - center.cross(&force),
            force,
            length: (arms.sum::<f64>() * share).sqrt(),
            contacts: contacts
                .iter()
                .map(|contact| {
                    let normal = Vector3::from(contact.1).cast::<f64>().normalize();
                    (place(contact) - center, normal, f64::from(contact.2), f64::from(contact.3))
                })
                .collect(),
        }
    }

    /// The largest violation of balance, cones and limits, over the load.
    fn violation(&self, forces: &[Vector3<f64>]) -> f64 {
        let (mut force, mut moment) = (self.force, self.moment);
        let mut worst = 0.0_f64;
        for ((arm, normal, friction, limit), one) in self.contacts.iter().zip(forces) {
            force -= one;
            moment -= arm.cross(one);
            let along = normal.dot(one);
            let across = (one - normal * along).norm();
            let most = friction * (1.0 - self.margin) * along;
            worst = worst.max(across - most).max(along - limit).max(self.least - along);
        }
        let size =
            |force: &Vector3<f64>, moment: &Vector3<f64>| force.norm().hypot(moment.norm() / self.length);
        worst.max(size(&force, &moment)) / size(&self.force, &self.moment)
    }

    /// Whether the load has more power against the twist than forces inside cones and limits have.
    fn separated(&self, linear: &Vector3<f64>, angular: &Vector3<f64>) -> bool {
        let most = self.contacts.iter().map(|(arm, normal, friction, limit)| {
            let velocity = linear + angular.cross(arm);
            let along = normal.dot(&velocity);
            let rate = along + friction * (1.0 - self.margin) * (velocity - normal * along).norm();
            (rate * limit).max(rate * self.least)
        });
        linear.dot(&self.force) + angular.dot(&self.moment) > most.sum()
    }
}

#[test]
fn grips_and_refusals_are_those_of_cvxpy() {
    let mut groups: BTreeMap<String, Vec<&Stored>> = BTreeMap::new();
    for case in STORED {
        groups.entry(format!("--margin={:?} --min={:?}", case.0, case.1)).or_default().push(case);
    }
    let (mut held, mut refused, mut open, mut worst, mut above) = (0, 0, 0, 0.0_f64, 0.0_f64);
    for (options, cases) in &groups {
        let (got, err) = grip(&options.split(' ').collect::<Vec<_>>(), &table(cases));
        let verdicts = &got["verdict"];
        assert_eq!(verdicts.len(), cases.len());
        for (row, case) in cases.iter().enumerate() {
            let (exact, &(_, _, _, contacts, least, boundary)) = (Exact::new(case), *case);
            let about = format!("{options}, row {row}, on the boundary: {boundary}");
            match verdicts[row].as_str() {
                "held" => {
                    held += 1;
                    assert!(least.is_some() || boundary, "{about}: cannot be held");
                    let forces: Vec<Vector3<f64>> = (1..=contacts.len())
                        .map(|i| {
                            let names = ["x", "y", "z"].map(|part| format!("f{i}{part}"));
                            vector(&got, names.each_ref().map(String::as_str), row)
                        })
                        .collect();
                    worst = worst.max(exact.violation(&forces));
                    let sum = 0.5 * forces.iter().map(Vector3::norm_squared).sum::<f64>();
                    if let (Some(least), false) = (least, boundary) {
                        above = above.max((sum / f64::from(least) - 1.0).abs());
                    }
                    for (i, (force, (_, normal, friction, _))) in
                        (1..).zip(forces.iter().zip(&exact.contacts))
                    {
                        let along = normal.dot(force);
                        let used = (force - normal * along).norm() / (friction * along).max(1e-30);
                        let told = [format!("normal{i}"), format!("used{i}")];
                        let [normal, share] = told.map(|name| number(&got, &name, row));
                        assert!((normal - along).abs() < 1e-5 * along.max(1.0), "{about}: {normal} {along}");
                        // Of no force there is no share.
                        assert!((share - used).abs() < 1e-3 || along < 1e-4, "{about}: {share} {used}");
                    }
                    assert_eq!(got["proof"][row], "");
                }
                "cannot-hold" => {
                    refused += 1;
                    assert!(least.is_none(), "{about}: can be held");
                    let twist =
                        [["vx", "vy", "vz"], ["wx", "wy", "wz"]].map(|names| vector(&got, names, row));
                    assert!(exact.separated(&twist[0], &twist[1]), "{about}: no proof");
                    assert_eq!((got["proof"][row].as_str(), got["f1x"][row].as_str()), ("checked", ""));
                }
                _ => {
                    open += 1;
                    assert!(number(&got, "rest", row) > 0.0 && got["f1x"][row].is_empty());
                }
            }
            for number in 1..=6 {
                let given = number <= contacts.len() && verdicts[row] == "held";
                assert_eq!(got[&format!("f{number}z")][row].is_empty(), !given);
            }
        }
        let count = |verdict: &str| verdicts.iter().filter(|one| *one == verdict).count();
        let [held, cannot, open] = ["held", "cannot-hold", "open"].map(count);
        let summary = format!("{} rows: {held} held, {cannot} cannot-hold, {open} open", cases.len());
        assert!(err.contains(&summary), "no {summary:?} in {err}");
    }
    println!(
        "{held} held, {refused} cannot, {open} open; violation {worst:.1e}, above the least {above:.1e}"
    );
    assert_eq!(held + refused + open, 300);
    assert!(held > 140 && refused > 100 && open <= 2, "{held} {refused} {open}");
    assert!(worst < 1e-4, "{worst}");
    // Of forces that hold the load the sum of squares is strictly convex: this near to the least one they are
    // themselves within √2e-4 = 1.4 % of the least forces.
    assert!(above < 2e-4, "{above}");
}

#[test]
fn two_opposed_contacts_hold_a_newton_with_a_newton_each() {
    let pinch = "-0.02,0,0.1,3,0,0,0.5,20,0.02,0,0.1,-1,0,0,0.5,20";
    let (got, err) = grip(&[], &format!("{PINCH}{pinch},0,0,1\n{pinch},0,0,0\n{pinch},0,0,30\n"));
    // Each carries half of it across the normal, and friction of a half takes twice that along it.
    has(&got, 0, &[("f1x", 1.0), ("f1y", 0.0), ("f1z", 0.5), ("normal1", 1.0), ("used1", 1.0)]);
    has(&got, 0, &[("f2x", -1.0), ("f2y", 0.0), ("f2z", 0.5), ("normal2", 1.0), ("used2", 1.0)]);
    has(&got, 0, &[("rest", 0.0), ("rank", 5.0)]);
    assert_eq!(got["condition"][0], "inf");
    // No load takes no grip, and its share of the friction is none.
    has(&got, 1, &[("normal1", 0.0), ("used1", 0.0), ("normal2", 0.0), ("used2", 0.0)]);
    // At most 2 · 0.5 · 20 N: it gives way downwards.
    assert_eq!((got["verdict"][2].as_str(), got["proof"][2].as_str()), ("cannot-hold", "checked"));
    has(&got, 2, &[("vx", 0.0), ("vy", 0.0), ("wx", 0.0), ("wy", 0.0), ("wz", 0.0)]);
    assert!(number(&got, "vz", 2) > 0.0);
    assert!(err.contains("3 rows: 2 held, 1 cannot-hold, 0 open"), "{err}");
}

#[test]
fn margin_least_force_friction_and_limit_can_be_options() {
    let table = "x1,y1,z1,nx1,ny1,nz1,x2,y2,z2,nx2,ny2,nz2,mu2,fx,fy,fz\n\
        -0.02,0,0,1,0,0,0.02,0,0,-1,0,0,,0,0,1\n\
        -0.02,0,0,1,0,0,0.02,0,0,-1,0,0,,0,0,0.1\n";
    let (got, _) = grip(&["--friction", "0.5", "--max", "20", "--margin", "0.2", "--min", "0.5"], table);
    // A push of 0.5/0.4 N; of the whole friction 80 % are used.
    has(&got, 0, &[("normal1", 1.25), ("used1", 0.8), ("normal2", 1.25), ("used2", 0.8)]);
    has(&got, 1, &[("normal1", 0.5), ("used1", 0.2), ("normal2", 0.5), ("used2", 0.2)]);
    // What the table says counts more.
    let (got, _) = grip(&["--friction", "0.1", "--max", "20"], &table.replace("0,0,,0", "0,0,0.9,0"));
    // Half a newton each, lest it turn: the contact with little friction needs the push.
    has(&got, 0, &[("normal1", 5.0), ("used1", 1.0), ("normal2", 5.0), ("used2", 1.0 / 9.0)]);
    let (got, _) = grip(&["--friction", "0.5", "--max", "0.9"], table);
    assert_eq!(got["verdict"], ["cannot-hold", "held"]);
}

#[test]
fn rows_leave_contacts_out_and_say_about_which_point_the_moment_is() {
    // Three fingers, or the first and the third; the moment of the weight at x = 0.03 m, about two points.
    let table = "name,x1,y1,z1,nx1,ny1,nz1,mu1,max1,x2,y2,z2,nx2,ny2,nz2,mu2,max2,x3,y3,z3,nx3,ny3,nz3,mu3,max3,\
        fx,fy,fz,mx,my,mz,ox,oy,oz\n\
        base,0,0.04,0,1,0,0,0.4,20,0,-0.04,0,1,0,0,0.4,20,0.06,0,0,-1,0,0,0.4,20,0,0,2,0,-0.06,0,0,0,0\n\
        weight,0,0.04,0,1,0,0,0.4,20,0,-0.04,0,1,0,0,0.4,20,0.06,0,0,-1,0,0,0.4,20,0,0,2,0,0,0,0.03,0,0\n\
        two,0,0,0,1,0,0,0.4,20,,,,,,,,,0.06,0,0,-1,0,0,0.4,20,0,0,2,0,0,0,0.03,0,0\n";
    let (got, err) = grip(&[], table);
    for row in [0, 1] {
        has(&got, row, &[("f1x", 1.25), ("f1z", 0.5), ("f2x", 1.25), ("f2z", 0.5), ("rank", 6.0)]);
        has(&got, row, &[("f3x", -2.5), ("f3z", 1.0), ("used3", 1.0)]);
    }
    has(&got, 2, &[("f1x", 2.5), ("f1z", 1.0), ("f3x", -2.5), ("f3z", 1.0), ("rank", 5.0)]);
    assert!(["f2x", "f2y", "f2z", "normal2", "used2"].iter().all(|name| got[*name][2].is_empty()));
    assert!(err.contains("unused columns: name"), "{err}");
}

#[test]
fn results_go_to_a_file_and_json_counts_the_verdicts() {
    let folder = tempfile::tempdir().unwrap();
    let [input, out] = ["grasps.csv", "grips.csv"].map(|name| folder.path().join(name));
    let pinch = "-0.02,0,0,1,0,0,0.5,20,0.02,0,0,-1,0,0,0.5,20";
    std::fs::write(&input, format!("{PINCH}{pinch},0,0,1\n{pinch},0,0,30\n")).unwrap();
    let [from, to] = [&input, &out].map(|path| path.to_str().unwrap());
    let arguments = ["--json", "eval", "grip", "--in", from, "--out", to];
    let (code, text, err) = tesaki(&arguments, "");
    assert_eq!((code, err.as_str()), (0, ""));
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    let expected = serde_json::json!({ "rows": 2, "held": 1, "cannot_hold": 1, "open": 0, "notes": [] });
    assert_eq!(value, expected);
    assert_eq!(std::fs::read_to_string(&out).unwrap().lines().count(), 3);

    // Of wrong input nothing is written, not even the rows before.
    std::fs::remove_file(&out).unwrap();
    std::fs::write(&input, format!("{PINCH}{pinch},0,0,1\n{pinch},0,0,heavy\n")).unwrap();
    let (code, text, _) = tesaki(&arguments, "");
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(
        code == 1 && value["error"].as_str().unwrap().contains("grasps.csv:3: column fz: \"heavy\""),
        "{text}"
    );
    assert!(!out.exists());
}

#[test]
fn what_does_not_fit_is_told_with_line_column_value_and_what_is_allowed() {
    let row = "-0.02,0,0,1,0,0,0.5,20,0.02,0,0,-1,0,0,0.5,20,0,0,1";
    let with = |column: &str, value: &str| {
        let names = PINCH.trim().split(',').zip(row.split(','));
        let cells = names.map(|(name, cell)| if name == column { value } else { cell });
        format!("{PINCH}{row}\n{}\n", cells.collect::<Vec<_>>().join(","))
    };
    for (input, expected) in [
        (with("mu1", "-0.5"), "3: column mu1: -0.5 is not a coefficient of friction: it is at least 0"),
        (with("mu2", "NaN"), "3: column mu2: NaN is not a finite number"),
        (with("mu2", ""), "3: column mu2 is empty: fill in a number, or give --friction for all"),
        (
            with("nx1", "0"),
            "3: columns nx1, ny1, nz1: (0, 0, 0) has no direction: give a vector into the object",
        ),
        (with("max2", "0"), "3: column max2: 0 N is not a largest normal force: it is more than 0"),
        (with("max2", "-3"), "3: column max2: -3 N is not a largest normal force: it is more than 0"),
        (with("max2", "inf"), "3: column max2: inf is not a finite number"),
        (with("max1", ""), "3: column max1 is empty: fill in a number, or give --max for all"),
        (
            with("y2", ""),
            "3: column y2 is empty, but x2 is not: fill in place and normal of contact 2, or nothing",
        ),
        (with("x1", "here"), "3: column x1: \"here\" is not a number"),
        (with("fz", ""), "3: column fz is empty: fill in a number"),
        (with("fz", "NaN"), "3: column fz: NaN is not a finite number"),
        (
            with("x2", "-0.02"),
            "3: columns x1 to z1, x2 to z2: contacts 1 and 2 are at the same place, 0 m from each",
        ),
        (with("x2", "3e38"), "3: the contacts are too far from each other to compute"),
        (with("fz", "1e30"), "3: load, distances or limits are too large or too small to compute"),
        (
            format!("{PINCH}{row}\n-0.02,0,0,1,0,0,0.5,20,,,,,,,,,0,0,1\n"),
            "3: only contact 1 is filled in, 1 in all: a grasp has 2 to 6",
        ),
        (format!("{PINCH},,,,,,,,,,,,,,,,0,0,1\n"), "2: no contact is filled in: a grasp has 2 to 6"),
        (format!("x7,{PINCH}1,{row}\n"), "1: column x7: contacts have the numbers 1 to 6"),
        (format!("mu0,{PINCH}1,{row}\n"), "1: column mu0: contacts have the numbers 1 to 6"),
        (format!("nz3,{PINCH}1,{row}\n"), "1: no column x3 (place of a contact [m]): add it"),
        (format!("mx,{PINCH}1,{row}\n"), "1: no column my (moment of the load [N·m]: all three, or none)"),
        (format!("oz,{PINCH}1,{row}\n"), "1: no column ox (point of the moment [m]: all three, or none)"),
        (
            PINCH.replace("mu2", "mu_2") + row,
            "1: no column mu2 (coefficient of friction, or --friction for all)",
        ),
        (PINCH.replace("max1", "f1") + row, "1: no column max1 (largest normal force [N], or --max for all)"),
        (PINCH.replace("fz", "Fz") + row, "1: no column fz (force that the contacts shall exert [N])"),
        ("x1,y1,z1,nx1,ny1,nz1,mu1,max1\n".to_owned(), "1: no rows after the header"),
        (
            "x1,y1,z1,nx1,ny1,nz1,mu1,max1\n0,0,0,1,0,0,1,1\n".to_owned(),
            "1: no column x2 (place of a contact [m])",
        ),
        (
            "x1;y1\n0;0\n".to_owned(),
            "1: no column x1 (place of a contact [m]): separate the columns by commas",
        ),
        (format!("{PINCH}1,2\n"), "2: the row has 2 values, the header 19 columns"),
    ] {
        let (code, out, err) = tesaki(&["eval", "grip", "--in", "-"], &input);
        assert_eq!((code, out.as_str()), (1, ""), "{err}");
        let expected = format!("tesaki: standard input:{expected}");
        assert!(err.starts_with(&expected), "no {expected:?} in: {err}");
    }
    let far = format!("ox,oy,oz,{PINCH}3e38,3e38,0,{row}\n");
    let (code, _, err) = tesaki(&["eval", "grip", "--in", "-"], &far);
    assert!(code == 1 && err.contains("standard input:2: columns ox, oy, oz: the point is too far"), "{err}");
    let far = with("y1", "3e38").replacen("\n-0.02,3e38", "\n3e38,3e38", 1);
    let (code, _, err) = tesaki(&["eval", "grip", "--in", "-"], &far);
    assert!(code == 1 && err.contains("standard input:3: columns x1, y1, z1: the place is too far"), "{err}");

    let weak = ["eval", "grip", "--in", "-", "--min", "3"];
    let (code, _, err) = tesaki(&weak, &with("max1", "2"));
    assert!(
        code == 1 && err.contains("3: column max1: 2 N is below the minimum normal force of 3 N"),
        "{err}"
    );
    for (option, value, expected) in [
        ("--margin", "1", "of at least 0 and less than 1"),
        ("--margin", "-0.1", "of at least 0 and less than 1"),
        ("--min", "-1", "of at least 0"),
        ("--friction", "NaN", "of at least 0"),
        ("--max", "0", "greater than 0"),
        ("--max", "much", "greater than 0"),
    ] {
        let (code, _, err) = tesaki(&["eval", "grip", "--in", "-", option, value], &with("", ""));
        let expected = format!("{value:?}: expected a number {expected}");
        assert!(code == 2 && err.contains(option) && err.contains(&expected), "{option} {value}: {err}");
    }
    let (code, _, err) = tesaki(&["eval", "grip", "--in", "/nowhere.csv"], "");
    assert!(code == 1 && err.contains("/nowhere.csv"), "{err}");
}
