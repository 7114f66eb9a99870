//! Tables of numbers as CSV, with errors that name file, line and column.

use std::path::Path;
use std::str::FromStr;

use csv::{ReaderBuilder, StringRecord, Trim};
use tesaki_description::spelling::meant;

use crate::failure::Failure;
use crate::feed::read_path;
use crate::output::counted;

/// Most bytes of a table: a million rows of sixteen numbers.
pub const MAX_TABLE: u64 = 1 << 27;

/// A CSV file: a header of names, rows of numbers.
pub struct Table {
    name: String,
    headers: Vec<String>,
    pub rows: Vec<Row>,
}

/// One line.
pub struct Row {
    pub line: u64,
    record: StringRecord,
}

impl Table {
    /// Reads the file at `path`; `-` is standard input.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let (name, text) = read_path(path, MAX_TABLE)?;
        Self::parse(&name, &text)
    }

    /// `name` is used in errors.
    pub fn parse(name: &str, text: &[u8]) -> Result<Self, Failure> {
        let unreadable = |error: csv::Error| Failure::Other(format!("{name}: {error}; is it CSV in UTF-8?"));
        let mut reader = ReaderBuilder::new().flexible(true).trim(Trim::All).from_reader(text);
        let headers: Vec<String> = reader.headers().map_err(unreadable)?.iter().map(str::to_owned).collect();
        let mut table = Self { name: name.to_owned(), headers, rows: Vec::new() };
        if table.headers.is_empty() {
            return Err(Failure::Other(format!("{name} is empty: its first line names the columns")));
        }
        for record in reader.into_records() {
            let record = record.map_err(unreadable)?;
            let line = record.position().map_or(0, |position| first_line(text, position));
            table.rows.push(Row { line, record });
        }
        table.check()?;
        Ok(table)
    }

    fn check(&self) -> Result<(), Failure> {
        if self.headers.iter().all(|header| header.parse::<f64>().is_ok()) {
            return Err(self.error(
                1,
                "the header is missing: the first line must name the columns, and has only numbers; `--help` tells \
                 the names",
            ));
        }
        for (index, header) in self.headers.iter().enumerate() {
            if self.headers.iter().take(index).any(|other| other == header) {
                return Err(self.error(1, &format!("two columns are called {header:?}: remove one")));
            }
        }
        if self.rows.is_empty() {
            return Err(self.error(1, "no rows after the header: nothing to compute"));
        }
        let columns = self.headers.len();
        match self.rows.iter().find(|row| row.record.len() != columns) {
            Some(row) => {
                let message = format!(
                    "the row has {}, the header {}: {}",
                    counted(row.record.len(), "value"),
                    counted(columns, "column"),
                    if row.record.len() < columns {
                        "add what is missing"
                    } else if self.headers.iter().any(|header| header.contains(';')) {
                        "separate the columns by commas, and write 1.5 for 1,5"
                    } else {
                        "remove what is too much"
                    }
                );
                Err(self.error(row.line, &message))
            }
            None => Ok(()),
        }
    }

    /// `name:line: message`
    pub fn error(&self, line: u64, message: &str) -> Failure {
        Failure::Other(format!("{}:{line}: {message}", self.name))
    }

    pub fn headers(&self) -> &[String] {
        &self.headers
    }

    pub fn header(&self, column: usize) -> &str {
        self.headers.get(column).map_or("?", String::as_str)
    }

    pub fn column(&self, name: &str) -> Option<usize> {
        self.headers.iter().position(|header| header == name)
    }

    /// The column `name`, which must be there; `what` tells what it holds.
    pub fn needed(&self, name: &str, what: &str) -> Result<usize, Failure> {
        self.column(name).ok_or_else(|| {
            let hint = match &*self.headers {
                [one] if one.contains([';', '\t']) => "separate the columns by commas".to_owned(),
                headers => format!("add it; the columns are {}", headers.join(", ")),
            };
            self.error(1, &format!("no column {name} ({what}): {hint}"))
        })
    }

    /// Refuses a column that was meant to be one of those that need not be there: it would be ignored.
    pub fn check_spelling(&self, optional: &[&str]) -> Result<(), Failure> {
        for header in &self.headers {
            if let Some(meant) = meant(header, optional).filter(|meant| self.column(meant).is_none()) {
                return Err(self.error(1, &format!("unknown column {header}: write {meant}, or remove it")));
            }
        }
        Ok(())
    }

    /// The columns `names` when there is any of them; then all must be there.
    pub fn all_or_none(&self, names: &[String], what: &str) -> Result<Option<Vec<usize>>, Failure> {
        let any = names.iter().any(|name| self.column(name).is_some());
        let all = || names.iter().map(|name| self.needed(name, what)).collect();
        any.then(all).transpose()
    }

    /// The numbers in `columns`; as many zeros where there are none.
    pub fn numbers<const N: usize>(
        &self,
        row: &Row,
        columns: Option<&Vec<usize>>,
    ) -> Result<[f32; N], Failure> {
        let mut numbers = [0.0; N];
        for (number, &column) in numbers.iter_mut().zip(columns.into_iter().flatten()) {
            *number = self.number(row, column)?;
        }
        Ok(numbers)
    }

    /// Whether the row has nothing in the column.
    pub fn is_empty(&self, row: &Row, column: usize) -> bool {
        row.record.get(column).is_none_or(str::is_empty)
    }

    /// What the row has in the column.
    pub fn text<'a>(&self, row: &'a Row, column: usize) -> &'a str {
        row.record.get(column).unwrap_or_default()
    }

    /// A finite number.
    pub fn number(&self, row: &Row, column: usize) -> Result<f32, Failure> {
        self.finite(row, column, |value: &f32| value.is_finite())
    }

    /// A finite number, such as a time, that needs more digits.
    pub fn precise(&self, row: &Row, column: usize) -> Result<f64, Failure> {
        self.finite(row, column, |value: &f64| value.is_finite())
    }

    fn finite<T: FromStr>(
        &self,
        row: &Row,
        column: usize,
        is_finite: impl Fn(&T) -> bool,
    ) -> Result<T, Failure> {
        let text = row.record.get(column).unwrap_or_default();
        let name = self.header(column);
        match text.parse::<T>() {
            Ok(value) if is_finite(&value) => Ok(value),
            Ok(_) => {
                Err(self
                    .error(row.line, &format!("column {name}: {text} is not a finite number: correct it")))
            }
            Err(_) if text.is_empty() => {
                Err(self.error(row.line, &format!("column {name} is empty: fill in a number")))
            }
            Err(_) => {
                let message = format!("column {name}: {text:?} is not a number: write it as 0.5 or 5e-1");
                Err(self.error(row.line, &message))
            }
        }
    }
}

/// The line of a record: its position is where the blank lines before it start.
fn first_line(text: &[u8], position: &csv::Position) -> u64 {
    let rest = usize::try_from(position.byte()).ok().and_then(|byte| text.get(byte..)).unwrap_or_default();
    let blank = rest.iter().take_while(|byte| byte.is_ascii_whitespace());
    position.line() + blank.map(|&byte| u64::from(byte == b'\n')).sum::<u64>()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn said(text: &str) -> String {
        let number = |table: Table| {
            let column = table.needed("a", "angle [rad]")?;
            table.rows.iter().try_for_each(|row| table.number(row, column).map(|_| ()))
        };
        Table::parse("states.csv", text.as_bytes()).and_then(number).unwrap_err().to_string()
    }

    #[test]
    fn every_bad_table_is_told_by_line_and_column() {
        for (text, expected) in [
            ("", "states.csv is empty: its first line names the columns"),
            ("1,2\n1,2\n", "states.csv:1: the header is missing: the first line must name the columns"),
            ("a,b\n", "states.csv:1: no rows after the header"),
            ("b,c\n1,2\n", "states.csv:1: no column a (angle [rad]): add it; the columns are b, c"),
            ("a;b\n1;2\n", "states.csv:1: no column a (angle [rad]): separate the columns by commas"),
            (
                "a;b\n1,5;2\n",
                "states.csv:2: the row has 2 values, the header 1 column: separate the columns by commas",
            ),
            ("a,a\n1,2\n", "states.csv:1: two columns are called \"a\""),
            ("a,b\n1,2\n3\n", "states.csv:3: the row has 1 value, the header 2 columns: add what is missing"),
            ("a,b\n1,2\n\n3,4,5\n", "states.csv:4: the row has 3 values, the header 2 columns: remove what"),
            ("a,b\n1,2\nNaN,2\n", "states.csv:3: column a: NaN is not a finite number"),
            ("a,b\n1e60,2\n", "states.csv:2: column a: 1e60 is not a finite number"),
            ("b,a\n1,2\n1,left\n", "states.csv:3: column a: \"left\" is not a number"),
            ("b,a\n1,\n", "states.csv:2: column a is empty"),
        ] {
            let said = said(text);
            assert!(said.starts_with(expected), "{text:?}: {said}");
        }
        let said = Table::parse("states.csv", b"a\n\xff\n").map(|_| ()).unwrap_err().to_string();
        assert!(said.contains("UTF-8"), "{said}");
    }

    #[test]
    fn blanks_quotes_and_a_byte_order_mark_do_no_harm() {
        let table = Table::parse("states.csv", "\u{feff}a,\"b\" \r\n 1 ,\t0.1\r\n".as_bytes()).unwrap();
        assert_eq!(table.headers(), ["a", "b"]);
        assert_eq!(table.number(&table.rows[0], 1).unwrap().to_bits(), 0.1_f32.to_bits());
    }
}
