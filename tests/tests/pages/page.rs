//! The commands of a page: the lines of its `sh` blocks, and those after `$` in its `console` blocks, with
//! the output that is shown.

/// A command of a page.
#[derive(Clone, Debug)]
pub struct Step {
    /// The second-level heading above it.
    pub section: String,
    /// The command without the comment.
    pub command: String,
    /// The text after `#`.
    pub comment: String,
    /// The lines below it in a `console` block.
    pub shown: Option<Vec<String>>,
}

impl Step {
    /// Returns the arguments if it is a command of `program`, written as `tesaki …` or as `cargo tesaki …`.
    pub fn arguments(&self, program: &str) -> Option<Vec<&str>> {
        let mut words = self.command.split_whitespace().skip_while(|word| *word == "cargo");
        (words.next() == Some(program)).then(|| words.collect())
    }
}

/// Returns all commands of a page, in order.
pub fn steps(page: &str) -> Vec<Step> {
    let (mut section, mut kind) = (String::new(), None);
    let mut steps: Vec<Step> = Vec::new();
    for line in page.lines() {
        match (line.strip_prefix("```"), kind) {
            (Some(_), Some(_)) => kind = None,
            (Some(opened), None) => kind = Some(opened),
            (None, Some("sh")) => {
                let (command, comment) = line.split_once(" #").unwrap_or((line, ""));
                steps.extend((!command.trim().is_empty()).then(|| Step {
                    section: section.clone(),
                    command: command.trim().to_owned(),
                    comment: comment.trim().to_owned(),
                    shown: None,
                }));
            }
            (None, Some("console")) => match (line.strip_prefix("$ "), steps.last_mut()) {
                (Some(command), _) => steps.push(Step {
                    section: section.clone(),
                    command: command.to_owned(),
                    comment: String::new(),
                    shown: Some(Vec::new()),
                }),
                (None, Some(Step { shown: Some(shown), .. })) => shown.push(line.to_owned()),
                (None, _) => panic!("a block `console` begins with {line:?}, not with a command"),
            },
            (None, None) => {
                if let Some(heading) = line.strip_prefix("## ") {
                    heading.clone_into(&mut section);
                }
            }
            (None, Some(_)) => {}
        }
    }
    steps
}

/// Returns a line without its numbers and checksums, with single spaces, and with `1 tick` as `2 ticks`.
pub fn without_numbers(line: &str) -> String {
    let mut masked = String::new();
    for word in line.split_whitespace() {
        let word = if masked.ends_with("0 ") { word.trim_end_matches('s') } else { word };
        let is_checksum = word.len() == 8 && word.chars().all(|c| c.is_ascii_hexdigit());
        let word = if is_checksum { "0" } else { word };
        // Exponent, sign and decimal point belong to the number.
        let mut letters = word.replace(|c: char| c.is_ascii_digit(), "0");
        for part in ["0e-0", "0.0", "-0", "00"] {
            while letters.contains(part) {
                letters = letters.replace(part, "0");
            }
        }
        masked = masked + &letters + " ";
    }
    masked.trim_end().to_owned()
}

/// Returns whether a program printed what a page shows: the same lines except for numbers. `…` stands for any
/// lines, and lines that differ only in their numbers may occur once or more often.
pub fn prints_as_shown(shown: &[String], printed: &str) -> bool {
    fn matches(shown: &[String], printed: &[String]) -> bool {
        match (shown.split_first(), printed.split_first()) {
            (None, None) => true,
            (Some((first, rest)), _) if first == "…" => {
                (0..=printed.len()).any(|skipped| matches(rest, &printed[skipped..]))
            }
            (Some((first, rest)), Some((line, lines))) => first == line && matches(rest, lines),
            _ => false,
        }
    }
    let lines = |lines: &mut dyn Iterator<Item = &str>| {
        let mut lines: Vec<String> = lines.map(without_numbers).filter(|line| !line.is_empty()).collect();
        lines.dedup();
        lines
    };
    // The reader presses it; it is not printed.
    let shown = lines(&mut shown.iter().map(String::as_str).filter(|line| *line != "^C"));
    matches(&shown, &lines(&mut printed.lines()))
}

#[test]
fn outputs_are_compared_up_to_their_numbers() {
    let shown = |lines: &[&str]| lines.iter().map(|&line| line.to_owned()).collect::<Vec<_>>();
    let page = shown(&["  0.72 s  the hand grips", "…", "done: -1.5e-3 of 12 N (x=-1, y=2.5)"]);
    assert!(prints_as_shown(&page, "0.5 s the hand grips\ndone: 10.0 of 1 N (x=0, y=2)\n"));
    assert!(prints_as_shown(
        &page,
        "1 s the hand grips\n2 s the hand grips\na\nb\ndone: 1 of 1 N (x=0, y=2)"
    ));
    assert!(!prints_as_shown(&page, "0.5 s the hand opens\ndone: 10.0 of 1 N (x=0, y=2)"));
    assert!(!prints_as_shown(&page, "0.5 s the hand grips\ndone: 10.0 of 1 N (x=0, z=2)"));
    assert!(!prints_as_shown(&page, "0.5 s the hand grips"));
    assert!(!prints_as_shown(&shown(&["a"]), "a\nb"));
    assert!(prints_as_shown(&shown(&["model 2a90dc08"]), "model 3c729a8e"));
    assert!(prints_as_shown(&shown(&["slips in 0 ticks"]), "slips in 1 tick"));
}
