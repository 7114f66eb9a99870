//! Every command in any document is valid for its program.

use std::path::{Path, PathBuf};

use crate::page;

/// Finds all documents under `folder`, except build products and other output.
fn documents(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in folder.read_dir().unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() {
            if !["target", "out", "node_modules"].contains(&name) && !name.starts_with('.') {
                documents(&path, found);
            }
        } else if name.ends_with(".md") {
            found.push(path);
        }
    }
}

/// Returns the words of a command up to the shell's redirections and pipes.
fn words(command: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    for c in command.chars() {
        match (quote, c) {
            (None, '\'' | '"') => quote = Some(c),
            (Some(open), _) if open == c => quote = None,
            (None, ' ') => words.push(String::new()),
            (None, '|' | '>' | '<' | '&' | ';') => break,
            _ => words.last_mut().unwrap().push(c),
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

#[test]
fn every_command_of_every_document_is_understood() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
    let mut pages = Vec::new();
    documents(&root, &mut pages);
    let mut understood = 0;
    let mut failures = Vec::new();
    for path in pages {
        for step in page::steps(&std::fs::read_to_string(&path).unwrap()) {
            let words = words(&step.command);
            let words: Vec<&str> =
                words.iter().map(String::as_str).skip_while(|word| *word == "cargo").collect();
            let Some((program, arguments)) = words.split_first() else { continue };
            let program = match *program {
                "sim" => "host-sim",
                "tesaki" => "tesaki",
                _ => continue,
            };
            // A placeholder for the reader's word.
            if arguments.iter().any(|word| word.contains('…')) {
                continue;
            }
            // Help replaces the command, but invalid arguments before it are still errors.
            let output = tesaki_tests::program(program).args(arguments).arg("--help").output().unwrap();
            understood += 1;
            if !output.status.success() {
                let said = String::from_utf8_lossy(&output.stderr);
                failures.push(format!("{}: `{}`: {said}", path.display(), step.command));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(understood >= 80, "only {understood} commands found");
}
