//! Lines of TOML files.

use std::collections::HashMap;

use toml::de::{DeTable, DeValue};

use crate::file::MAX_TOML;

/// How deep tables and lists are looked into.
const MAX_DEPTH: usize = 12;

/// The lines of a TOML text where keys have their values or start a table. A key is written with its tables,
/// as `joint.motor.delay`; entries of a list are numbered from 0, as in `contact.1.normal`.
#[derive(Debug, Default)]
pub struct Lines(HashMap<String, usize>);

impl Lines {
    /// Of a text, which may be wrong in parts; none of one that is too long to be read.
    pub fn of(text: &str) -> Self {
        let mut lines = Self::default();
        if text.len() <= MAX_TOML {
            let starts: Vec<usize> = text.match_indices('\n').map(|(end, _)| end + 1).collect();
            lines.add_table(&DeTable::parse_recoverable(text).0.into_inner(), "", &starts, MAX_DEPTH);
        }
        lines
    }

    /// The line of `key`, counted from 1.
    pub fn get(&self, key: &str) -> Option<usize> {
        self.0.get(key).copied()
    }

    fn add_table(&mut self, table: &DeTable<'_>, path: &str, starts: &[usize], depth: usize) {
        for (name, value) in table {
            let path = if path.is_empty() { name.to_string() } else { format!("{path}.{name}") };
            self.add(path, name.span().start, value.get_ref(), starts, depth);
        }
    }

    fn add(&mut self, path: String, start: usize, value: &DeValue<'_>, starts: &[usize], depth: usize) {
        match (value, depth.checked_sub(1)) {
            (DeValue::Table(table), Some(depth)) => self.add_table(table, &path, starts, depth),
            (DeValue::Array(entries), Some(depth)) => {
                for (index, entry) in entries.iter().enumerate() {
                    self.add(format!("{path}.{index}"), entry.span().start, entry.get_ref(), starts, depth);
                }
            }
            _ => {}
        }
        self.0.insert(path, 1 + starts.partition_point(|line| *line <= start));
    }
}

/// The key, with its tables, of the value of a TOML text that has the byte `place`.
pub fn key_at(text: &str, place: usize) -> Option<String> {
    of_table(&DeTable::parse_recoverable(text).0.into_inner(), place, MAX_DEPTH)
}

fn of_table(table: &DeTable<'_>, place: usize, depth: usize) -> Option<String> {
    table.iter().find_map(|(name, value)| {
        let inner = within(value.get_ref(), place, depth).map(|inner| format!("{name}.{inner}"));
        inner.or_else(|| value.span().contains(&place).then(|| name.to_string()))
    })
}

fn within(value: &DeValue<'_>, place: usize, depth: usize) -> Option<String> {
    let depth = depth.checked_sub(1)?;
    match value {
        DeValue::Table(table) => of_table(table, place, depth),
        DeValue::Array(entries) => entries.iter().find_map(|entry| within(entry.get_ref(), place, depth)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::{Lines, key_at};

    #[test]
    fn keys_have_their_lines_in_tables_lists_and_inline_tables() {
        let text = "[control] # one\nmass = { matrix = [\n    [1.0, 0.0],\n    [0.0, 1.0]\n], of = 'b = 3' }\n\
                    k = [\n [2.0]\n]\nb = 3\n[[a.list]]\nb = 4\n[[a.list]]\nc = { b = 5,\n d.e = 6 }\n\
                    s = '''\nt = 7\n[u]\n'''\nv = 8\n";
        let lines = Lines::of(text);
        for (key, line) in [
            ("control", Some(1)),
            ("control.mass.matrix.1", Some(4)),
            ("control.mass.of", Some(5)),
            ("control.k", Some(6)),
            ("control.b", Some(9)),
            ("a", Some(10)),
            ("a.list", Some(10)),
            ("a.list.0.b", Some(11)),
            ("a.list.1", Some(12)),
            ("a.list.1.c.b", Some(13)),
            ("a.list.1.c.d.e", Some(14)),
            ("a.list.1.t", None),
            ("u", None),
            ("a.list.1.v", Some(19)),
        ] {
            assert_eq!(lines.get(key), line, "{key}");
        }
    }

    #[test]
    fn a_value_is_named_by_its_key() {
        for (text, key) in [
            ("[grasp]\nmass = @", Some("grasp.mass")),
            ("a = 1\ndamping = { translation = 3, rotation = @ }", Some("damping.rotation")),
            ("pid = { of = { a = 1 }, derivative = @, b = 2 }", Some("pid.derivative")),
            ("stiffness = { matrix = [\n  [1.0, 2.0],\n  [@, 3.0] ] }", Some("stiffness.matrix")),
            ("[[contact]]\nnormal = 1\n[[contact]]\nnormal = [@]", Some("contact.normal")),
            ("s = '''\na = @\n'''", Some("s")),
            ("[motion]\n# @\na = 1", None),
        ] {
            let place = text.find('@').unwrap_or_default();
            assert_eq!(key_at(&text.replace('@', "7"), place).as_deref(), key, "{text}");
        }
    }

    #[test]
    fn a_key_with_thousands_of_parts_does_no_harm() {
        let text = format!("b = 2\na{} = 1\n", ".a".repeat(30_000));
        assert_eq!((key_at(&text, 4).as_deref(), Lines::of(&text).get("b")), (Some("b"), Some(1)));
    }
}
