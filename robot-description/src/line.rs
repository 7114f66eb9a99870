//! Lines of TOML files.

/// The line where `key` (with its tables, or their end) has its value or starts a table.
pub fn line_of(text: &str, key: &str) -> Option<usize> {
    let last = key.rsplit('.').next().unwrap_or(key);
    let mut header = "";
    for (number, line) in (1..).zip(text.lines()) {
        let is_header = is_header(line);
        if is_header {
            header = line;
        }
        // A long file has many keys to look for: most lines get no closer look.
        if !line.contains(last) {
            continue;
        }
        let table = bare(header);
        let table = table.strip_prefix('[').and_then(|line| line.split(']').next());
        let table = table.map_or_else(String::new, |name| format!(".{name}"));
        let here = if is_header {
            table
        } else {
            match bare(line).split_once('=') {
                Some((name, _)) if !name.starts_with('#') => format!("{table}.{name}"),
                _ => continue,
            }
        };
        if here.ends_with(&format!(".{key}")) || here.contains(&format!(".{key}.")) {
            return Some(number);
        }
    }
    None
}

/// Whether a table begins here: `[name]`, and not a row of a matrix, `[1.0, 0.0],`.
fn is_header(line: &str) -> bool {
    let Some((name, rest)) = line.trim_start().strip_prefix('[').and_then(|line| line.split_once(']')) else {
        return false;
    };
    let rest = rest.trim_start_matches(']').trim_start();
    (rest.is_empty() || rest.starts_with('#')) && !name.contains(',') && name.trim().parse::<f64>().is_err()
}

/// Without blanks and quotes.
fn bare(line: &str) -> String {
    line.chars().filter(|c| !c.is_whitespace() && !"\"'".contains(*c)).collect()
}

#[cfg(test)]
mod tests {
    use super::line_of;

    #[test]
    fn rows_of_a_matrix_begin_no_table() {
        let text = "[control] # one\nmass = { matrix = [\n    [1.0, 0.0],\n    [0.0, 1.0]\n] }\nk = [\n [2.0]\n]\nb = 3\n[[a.list]]\nb = 4\n";
        assert_eq!(line_of(text, "control.k"), Some(6));
        assert_eq!(line_of(text, "control.b"), Some(9));
        assert_eq!(line_of(text, "list.b"), Some(11));
    }
}
