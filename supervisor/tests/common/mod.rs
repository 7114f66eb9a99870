//! Runs `tesaki` and reads its tables.

mod feed;

use std::collections::BTreeMap;
use std::process::Command;

use feed::feed;

/// Exit code, standard output, standard error of `tesaki`, which reads `input`.
pub fn tesaki(arguments: &[&str], input: &str) -> (i32, String, String) {
    feed(Command::new(env!("CARGO_BIN_EXE_tesaki")).args(arguments), input)
}

/// Columns by name.
pub fn columns(text: &str) -> BTreeMap<String, Vec<String>> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let column = |index: usize| rows.iter().map(|row: &Vec<&str>| row[index].to_owned()).collect();
    names.iter().enumerate().map(|(index, name)| ((*name).to_owned(), column(index))).collect()
}
