//! The documents match the code: equations and the functions that compute them, faults and refusals, the
//! example. Copies are identical. Documents and comments keep to the maximum width.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::collections::BTreeSet;
use std::fs::read_to_string;
use std::path::{Path, PathBuf};

use tesaki::fault::FaultCause;

#[allow(dead_code, reason = "the example's `main`")]
#[path = "../../shared/examples/minimal_node.rs"]
mod minimal_node;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn document(name: &str) -> String {
    read_to_string(root().join("docs").join(name)).unwrap()
}

/// Returns the Rust files under a folder, with their text.
fn sources(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    for entry in folder.read_dir().unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.ends_with("target") && !path.ends_with("node_modules") {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = read_to_string(&path).unwrap();
            found.push((path, text));
        }
    }
    found
}

/// Returns the text between the first pair of backticks.
fn quoted(text: &str) -> Option<&str> {
    text.split('`').nth(1)
}

/// Returns whether `text` contains `word` as a whole word.
fn has_word(text: &str, word: &str) -> bool {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word)
        .any(|(at, _)| !text[..at].ends_with(part) && !text[at + word.len()..].starts_with(part))
}

/// Beginnings of rows with instruction counts on the Cortex-M4F, and the corresponding benchmarks.
const BENCHMARKS: [(&str, &[&str]); 16] = [
    ("| PID; trajectory filter;", &["pid", "trajectory_filter", "sin_cos", "node_tick_9_observer"]),
    (
        "| inverse kinematics of a finger;",
        &["finger_nearest", "forward_and_jacobian_7", "bias_acceleration_7"],
    ),
    ("| torques of 7 joints under a wrench;", &["inverse_dynamics_7_wrench", "mass_matrix_7"]),
    ("| encoding and decoding the largest telemetry |", &["codec_largest_telemetry"]),
    ("| encoding and decoding the largest telemetry,", &["codec_largest_telemetry"]),
    ("| least grip of three contacts", &["least_grip_3_warm", "least_grip_3_infeasible"]),
    ("| retargeting five fingers,", &["retarget_longest", "retarget_unreachable_longest"]),
    (
        "| the same with directions |",
        &["retarget_directions_longest", "retarget_directions_unreachable_longest"],
    ),
    (
        "| the first frame of a stretched hand",
        &["retarget_first_unreachable_longest", "retarget_first_directions_unreachable_longest"],
    ),
    ("| longest frame of the Inspire", &["retarget_mimics_longest", "retarget_mimics_unreachable_longest"]),
    ("| longest tick of a board whose Inspire", &["node_tick_mimics_following_longest"]),
    ("| whole, with the grasp map (3", &["least_grip_3_warm", "least_grip_6_warm"]),
    ("| whole, with the grasp map: from", &["least_grip_3_cold", "least_grip_6_cold"]),
    ("| whole, with the grasp map: proof", &["least_grip_3_infeasible", "least_grip_3_too_heavy"]),
    ("| longest call from nothing:", &["least_grip_3_slice_cold", "least_grip_3_slice_infeasible"]),
    ("| longest call of the stored", &["least_grip_3_slice_worst", "least_grip_6_slice_worst"]),
];

#[test]
fn instructions_are_those_of_the_last_recorded_benchmark() {
    let (page, records) = (document("measurements.md"), document("benchmarks.jsonl"));
    let record: serde_json::Value = serde_json::from_str(records.lines().last().unwrap()).unwrap();
    for (beginning, names) in BENCHMARKS {
        let [row] = page.lines().filter(|line| line.starts_with(beginning)).collect::<Vec<_>>()[..] else {
            panic!("{beginning}")
        };
        // The last numbers of the row, in one or two columns.
        let without_unit = row.trim_end_matches('|').trim_end().trim_end_matches(" instructions");
        let without_limits = without_unit.split("instructions |").last().unwrap();
        let cells = without_limits.split(['|', ';']).map(|cell| cell.replace([' ', '*'], ""));
        let numbers: Vec<f64> = cells.filter_map(|cell| cell.parse().ok()).collect();
        for (index, name) in names.iter().enumerate() {
            let recorded = record["instructions"][name].as_f64().unwrap_or_else(|| panic!("{name}"));
            let told = numbers[numbers.len() - names.len() + index];
            assert!((told - recorded).abs() <= 0.5, "{row}\n{name}: {recorded} of {}", record["commit"]);
        }
    }
}

#[test]
fn every_function_of_the_equations_is_in_its_file() {
    let page = document("equations.md");
    let mut functions = 0;
    let tables = page.split("\n\n").filter(|table| {
        let header = table.lines().next().unwrap_or_default();
        ["| eq. |", "| step |", "| section |"].iter().any(|first| header.starts_with(first))
    });
    for line in tables.flat_map(|table| table.lines().skip(2)) {
        let [.., function, file, _] = line.split('|').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let (Some(path), Some(file)) = (quoted(function), quoted(file)) else {
            panic!("docs/equations.md: no function or no file in {line}")
        };
        assert!(path.starts_with("tesaki::"), "{line}");
        let text = read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        let mut parts = path.rsplit("::");
        let name = parts.next().unwrap();
        let declared = ["(", "<"].iter().any(|next| text.contains(&format!("fn {name}{next}")));
        assert!(declared, "docs/equations.md names `{path}`, but there is no `fn {name}` in {file}");
        let owner = parts.next().unwrap();
        if owner.starts_with(char::is_uppercase) {
            assert!(has_word(&text, owner), "docs/equations.md names `{path}`, but {file} has no {owner}");
        }
        functions += 1;
    }
    assert!(functions >= 40, "only {functions} functions found");
}

#[test]
fn every_numbered_equation_of_the_papers_has_a_row() {
    let page = document("equations.md");
    for (paper, count) in [("Hand3", 25), ("Arm7", 3), ("Hand5", 2), ("Knob", 2)] {
        let (_, section) = page.split_once(&format!("\n## {paper}\n")).unwrap();
        let section = section.split("\n## ").next().unwrap();
        // The numbered equations are in the section's first table.
        let rows = section.lines().skip_while(|line| !line.starts_with("| eq.")).skip(2);
        let numbers: BTreeSet<u32> = rows
            .take_while(|line| line.starts_with('|'))
            .map(|line| line.split('|').nth(1).unwrap().trim().parse().unwrap())
            .collect();
        assert_eq!(numbers, (1..=count).collect(), "{paper}");
    }
    let key = read_to_string(root().join("shared/src/papers.md")).unwrap();
    for paper in ["Hand3", "Arm7", "Hand5", "Knob"] {
        assert!(key.contains(&format!("\n| {paper} |")), "shared/src/papers.md has no {paper}");
    }
}

/// Returns the variants of an enumeration, in order.
fn variants(source: &str, name: &str) -> Option<Vec<String>> {
    let (_, body) = source.split_once(&format!("pub enum {name} {{\n"))?;
    let (body, _) = body.split_once("\n}\n")?;
    let variant = |line: &str| {
        let line = line.strip_prefix("    ").filter(|line| line.starts_with(char::is_uppercase))?;
        Some(line.split(|c: char| !c.is_alphanumeric()).next()?.to_owned())
    };
    Some(body.lines().filter_map(variant).collect())
}

/// Returns the entries of docs/troubleshooting.md under the heading of an enumeration: name and text of each.
fn entries<'a>(page: &'a str, name: &str) -> Vec<(&'a str, &'a str)> {
    let heading = page.lines().find(|line| line.starts_with("## ") && quoted(line) == Some(name));
    let heading = heading.unwrap_or_else(|| panic!("docs/troubleshooting.md has no section for `{name}`"));
    let section = page.split_once(heading).unwrap().1.split("\n## ").next().unwrap();
    section.split("\n### ").skip(1).map(|entry| (quoted(entry).unwrap(), entry)).collect()
}

/// Sections of docs/troubleshooting.md with an entry for each variant.
const EXPLAINED: &[&str] = &[
    "FaultCause",
    "Refusal",
    "LimitRefusal",
    "JointServoRefusal",
    "GraspRefusal",
    "InvalidPlan",
    "ImpedanceRefusal",
    "SetpointError",
    "InvalidImpedanceSettings",
    "TelexistenceRefusal",
    "VisualApproachRefusal",
    "Problem",
    "BoardError",
];

#[test]
fn every_fault_and_every_refusal_has_an_entry_and_no_entry_is_about_another() {
    let page = document("troubleshooting.md");
    let sources = [sources(&root().join("shared/src")), sources(&root().join("supervisor/src"))].concat();
    for name in EXPLAINED {
        let found = sources.iter().find_map(|(_, text)| variants(text, name));
        let variants = found.unwrap_or_else(|| panic!("no `pub enum {name}`"));
        assert!(!variants.is_empty(), "{name}");
        let entries = entries(&page, name);
        let names: Vec<_> = entries.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, variants, "docs/troubleshooting.md, section {name}");
        for (entry, text) in entries {
            // A heading, then the meaning and the remedy.
            let words = text.lines().skip(1).flat_map(str::split_whitespace).count();
            assert!(words >= 8, "docs/troubleshooting.md: {name}, {entry}: too short to help");
        }
    }
    let sections = page.lines().filter_map(|line| quoted(line.strip_prefix("## ")?));
    let sections: BTreeSet<_> = sections.collect();
    assert_eq!(sections, EXPLAINED.iter().copied().collect());
    for (number, cause) in
        variants(&read_to_string(root().join("shared/src/fault.rs")).unwrap(), "FaultCause")
            .unwrap()
            .iter()
            .enumerate()
    {
        let heading = format!("\n### Fault {number}: `{cause}`\n");
        assert!(page.contains(&heading), "docs/troubleshooting.md has no heading {heading:?}");
    }
}

/// The faults after which the outputs are switched off regardless of the model's reaction.
#[test]
fn the_faults_that_leave_no_control_are_those_of_the_documents() {
    let causes = (0..).map_while(|number: u8| postcard::from_bytes::<FaultCause>(&[number]).ok());
    let off: Vec<u8> = causes.filter(|cause| !cause.leaves_control()).map(FaultCause::number).collect();
    let numbers = |text: &str| -> Vec<u8> {
        text.split(|c: char| !c.is_ascii_digit()).filter_map(|word| word.parse().ok()).collect()
    };
    let page = document("troubleshooting.md").replace('\n', " ");
    let (_, list) = page.split_once("After faults ").unwrap();
    assert_eq!(numbers(list.split_once(" they go off at once").unwrap().0), off, "docs/troubleshooting.md");
    let page = document("protocol.md");
    let rows = page.lines().filter(|line| line.split('|').nth(3).is_some_and(|cell| cell.trim() == "yes"));
    let rows = rows.filter(|line| line.split('|').count() == 8);
    let marked: Vec<u8> = rows.filter_map(|line| line.split('|').nth(1)?.trim().parse().ok()).collect();
    assert_eq!(marked, off, "docs/protocol.md, column *always off*");
}

/// The number of fault schedules that break a rule.
#[test]
fn the_documents_count_the_recorded_fault_schedules() {
    let record: serde_json::Value = serde_json::from_str(&document("fault-schedules.json")).unwrap();
    let seeds = record["violations"].as_object().unwrap().values();
    let seeds: BTreeSet<_> =
        seeds.flat_map(|seeds| seeds.as_array().unwrap()).map(|seed| seed.as_u64().unwrap()).collect();
    let (count, all) = (seeds.len(), record["schedules"].as_u64().unwrap());
    let all = format!("{} {:03}", all / 1000, all % 1000);
    for (page, sentence) in [
        ("measurements.md", format!("that break a rule of safety, of {all} | 0 | {count} |")),
        ("features.md", format!("- {count} of {all} [fault schedules](fault-schedules.md) break a rule;")),
        ("fault-schedules.md", format!(". {count} of them break a rule, ")),
    ] {
        assert!(document(page).contains(&sentence), "docs/{page} lacks: {sentence}");
    }
}

/// Returns the rows of the control core's table of layers.
fn layers() -> Vec<String> {
    let comment = comment("shared/src/lib.rs");
    let rows = comment.lines().filter(|line| line.starts_with("| ")).map(|line| line.replace(['[', ']'], ""));
    let rows = rows.collect::<Vec<_>>();
    assert!(rows.len() > 10, "{rows:?}");
    rows
}

/// Each module of the control core uses only those above it.
#[test]
fn no_module_uses_a_layer_below_it() {
    let rows = layers();
    let modules: Vec<&str> = rows.iter().filter_map(|row| quoted(row)).collect();
    let folder = root().join("shared/src");
    let mut uses = 0;
    for (path, text) in sources(&folder) {
        let own = path.strip_prefix(&folder).unwrap().iter().next().unwrap().to_str().unwrap();
        let Some(own) = modules.iter().position(|module| *module == own.trim_end_matches(".rs")) else {
            continue;
        };
        let code: String =
            text.lines().map(|line| line.split("//").next().unwrap().to_owned() + "\n").collect();
        for rest in code.split("crate::").skip(1) {
            // One path, or a list of paths.
            let end = if rest.starts_with('{') {
                rest.find(';')
            } else {
                rest.find(|c: char| !c.is_alphanumeric())
            };
            let used = &rest[..end.unwrap()];
            let below = modules[own + 1..].iter().find(|module| has_word(used, module));
            assert_eq!(below, None, "{} uses a module below `{}`", path.display(), modules[own]);
            uses += 1;
        }
    }
    assert!(uses > 500, "only {uses} uses found");
}

/// Returns the type of the error in `rest`, the text behind `Result<`; `None` for an alias of `Result`.
fn error_type(rest: &str) -> Option<&str> {
    let (mut depth, mut comma) = (0, 0);
    for (at, character) in rest.char_indices() {
        match character {
            ';' | '{' => return None,
            ',' if depth == 0 => comma = at,
            '<' | '(' | '[' => depth += 1,
            ')' | ']' => depth -= 1,
            '>' if !rest[..at].ends_with('-') && depth == 0 => {
                let name = rest[comma..at].trim_matches([',', ' ', '\n']).rsplit("::").next().unwrap();
                return Some(name).filter(|_| comma > 0);
            }
            '>' if !rest[..at].ends_with('-') => depth -= 1,
            _ => {}
        }
    }
    None
}

/// Every public type that a `Result` of the control core has as its error implements `Error`.
#[test]
fn every_error_of_the_control_core_implements_error() {
    let folder = root().join("shared/src");
    let mut files = sources(&folder);
    files.retain(|(path, _)| path.strip_prefix(&folder).unwrap().iter().all(|part| part != "tests"));
    let has = |text: &str| files.iter().any(|(_, file)| file.contains(text));
    let is_public = |name: &str| {
        ["struct", "enum"]
            .iter()
            .any(|kind| [" ", ";", "("].iter().any(|end| has(&format!("pub {kind} {name}{end}"))))
    };
    let names: BTreeSet<&str> = files
        .iter()
        .flat_map(|(_, text)| text.split("Result<").skip(1))
        .filter_map(error_type)
        .filter(|name| is_public(name))
        .collect();
    assert!(names.len() > 40, "only {names:?} found");
    for name in names {
        let implements =
            ["core::error::Error", "Error"].iter().any(|of| has(&format!("impl {of} for {name} ")));
        assert!(implements, "{name} does not implement `core::error::Error`");
    }
}

/// A name means one thing in the whole control core.
#[test]
fn no_two_types_of_the_control_core_share_a_name() {
    let folder = root().join("shared/src");
    let mut names = BTreeSet::new();
    for (path, text) in sources(&folder) {
        if path.strip_prefix(&folder).unwrap().iter().any(|part| part.to_string_lossy().contains("test")) {
            continue;
        }
        for line in text.lines().filter(|line| line.trim_start().starts_with("pub")) {
            let [_, kind, name, ..] = line.split_whitespace().collect::<Vec<_>>()[..] else { continue };
            if ["struct", "enum", "trait", "type"].contains(&kind) {
                let name = name.split(|c: char| !c.is_alphanumeric()).next().unwrap().to_owned();
                assert!(names.insert(name.clone()), "{}: another type is called {name}", path.display());
            }
        }
    }
    assert!(names.len() > 200, "only {} types found", names.len());
}

/// Copies of the architecture's mode diagram.
#[test]
fn modes_are_those_of_the_architecture() {
    let page = document("architecture.md");
    let section = |heading: &str| page.split_once(heading).unwrap().1.split("\n## ").next().unwrap();
    let diagram = section("\n## Modes\n").split("```").nth(1).unwrap();
    assert!(comment("shared/src/node/mod.rs").contains(diagram), "shared/src/node/mod.rs has other modes");
    assert!(document("protocol.md").contains(diagram), "docs/protocol.md has other modes");
}

/// Returns the comment at the top of a file.
fn comment(path: &str) -> String {
    let text = read_to_string(root().join(path)).unwrap();
    text.lines()
        .map_while(|line| line.strip_prefix("//!"))
        .fold(String::new(), |text, line| text + line.strip_prefix(' ').unwrap_or(line) + "\n")
}

/// The sources of reference values exist.
#[test]
fn the_oracles_that_are_named_exist() {
    let mut named = 0;
    for crates in ["shared", "host-sim", "supervisor", "drivers", "recording", "robot-description", "tests"] {
        for (path, text) in sources(&root().join(crates)) {
            for rest in text.split("tests/oracles/").skip(1) {
                let Some((name, _)) = rest.split_once(".py") else { continue };
                if !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
                    let file = root().join(format!("tests/oracles/{name}.py"));
                    assert!(file.exists(), "{}: no tests/oracles/{name}.py", path.display());
                    named += 1;
                }
            }
        }
    }
    assert!(named > 20, "only {named} oracles found");
}

/// No refusal of a new task is forgotten, because all of them implement `Concerns`.
#[test]
fn the_refusals_of_every_task_are_explained() {
    let mut found = 0;
    for (path, text) in sources(&root().join("shared/src")) {
        for rest in text.split("\nimpl Concerns for ").skip(1) {
            let name = rest.split(' ').next().unwrap();
            if name != "TaskRefusal" {
                assert!(EXPLAINED.contains(&name), "{name} of {} is not explained", path.display());
            }
            found += 1;
        }
    }
    assert!(found >= 5, "only {found} kinds of refusals found");
}

#[test]
fn the_smallest_node_prints_what_the_documents_quote() {
    let line = minimal_node::run().unwrap();
    assert!(
        document("architecture.md").contains(&format!("\n{line}\n")),
        "docs/architecture.md lacks: {line}"
    );
}

/// Returns the pages at the top level and in docs/.
/// All pages of the project.
fn pages() -> Vec<PathBuf> {
    let (mut pages, mut folders) = (Vec::new(), vec![root()]);
    while let Some(folder) = folders.pop() {
        for entry in folder.read_dir().unwrap().map(|entry| entry.unwrap()) {
            let (path, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
            let is_made = name.starts_with('.') || ["target", "out", "node_modules"].contains(&name.as_str());
            if entry.file_type().unwrap().is_dir() && !is_made {
                folders.push(path);
            } else if name.ends_with(".md") {
                pages.push(path);
            }
        }
    }
    assert!(pages.len() > 40, "only {} pages found", pages.len());
    pages
}

/// The anchors of a page's headings, as GitHub makes them.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let anchor = |heading: &str| {
        let words = heading.trim_start_matches('#').trim().to_lowercase();
        words
            .chars()
            .filter(|letter| letter.is_alphanumeric() || [' ', '-', '_'].contains(letter))
            .map(|letter| if letter == ' ' { '-' } else { letter })
            .collect()
    };
    headings.map(anchor).collect()
}

/// Rustfmt limits code to 110 columns, but does not wrap comments. Tables, listings, quotations, pictures and
/// single words may be longer.
#[test]
fn comments_and_prose_end_at_110_columns() {
    let mut too_long = Vec::new();
    let mut read = |path: &Path, text: &str, is_prose: &dyn Fn(&str) -> bool| {
        let mut is_listing = false;
        for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| is_prose(line)) {
            let words = line.trim_start().trim_start_matches(['/', '!']).trim_start();
            is_listing ^= words.starts_with("```");
            let may_be_long =
                is_listing || words.starts_with(['|', '>']) || line.starts_with("![") || !words.contains(' ');
            if line.chars().count() > 110 && !may_be_long {
                too_long.push(format!("{}:{number}", path.display()));
            }
        }
    };
    for page in pages() {
        read(&page, &read_to_string(&page).unwrap(), &|_| true);
    }
    let mut files = 0;
    for entry in root().read_dir().unwrap().map(|entry| entry.unwrap()) {
        let name = entry.file_name();
        if entry.path().is_dir() && name != "target" && !name.to_string_lossy().starts_with('.') {
            for (path, text) in sources(&entry.path()) {
                read(&path, &text, &|line| line.trim_start().starts_with("//"));
                files += 1;
            }
        }
    }
    assert!(files > 500, "only {files} files found");
    assert!(too_long.is_empty(), "beyond 110 columns:\n{}", too_long.join("\n"));
}

/// Every relative link of the documents points to a file.
#[test]
fn links_between_documents_lead_somewhere() {
    let mut links = 0;
    for page in pages() {
        let text = read_to_string(&page).unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            if file.contains("://") {
                continue;
            }
            let target = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: no {file}", page.display());
            let is_there = anchor.is_empty() || anchors(&read_to_string(&target).unwrap()).contains(anchor);
            assert!(is_there, "{}: {link} has no such heading", page.display());
            links += 1;
        }
    }
    assert!(links >= 200, "only {links} links found");
}

/// Returns the pins named in `text` by a port's letter and a number, such as PB13 with `prefix` "P".
fn pins(text: &str, prefix: &str) -> BTreeSet<String> {
    let name = |(at, _): (usize, &str)| {
        let end = text[at + prefix.len()..].find(|c: char| !c.is_alphanumeric())? + at + prefix.len();
        let name = text[at + prefix.len() - 1..end].to_uppercase();
        let is_pin = name.len() > 2 && "ABCD".contains(&name[1..2]) && name[2..].parse::<u8>().is_ok();
        is_pin.then_some(name)
    };
    text.match_indices(prefix).filter_map(name).collect()
}

/// A pin that is missing in a table, or unused by the code, may be a gate signal.
#[test]
fn the_pins_of_each_board_are_those_of_its_table() {
    let firmware = root().join("firmware");
    for (board, table) in
        [("weact", "src/boards/weact.rs"), ("odrive", "src/boards/odrive.rs"), ("bare", "README.md")]
    {
        let code = read_to_string(firmware.join("src/boards").join(board).with_extension("rs")).unwrap();
        let table = read_to_string(firmware.join(table)).unwrap();
        let rows = table.lines().filter_map(|line| line.trim_start_matches("//! ").strip_prefix("| P"));
        let first_columns: String = rows.map(|row| format!("P{} ", row.split('|').next().unwrap())).collect();
        let (told, taken) = (pins(&first_columns, "P"), pins(&code, ".p"));
        assert!(told.len() > 4, "{board}: {told:?}");
        assert_eq!(told, taken, "{board}: pins in the table, and those that the code takes");
    }
}
