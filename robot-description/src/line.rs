//! Lines of TOML files.

/// The line where `key` (with its tables, or their end) has its value or starts a table.
pub fn line_of(text: &str, key: &str) -> Option<usize> {
    let last = key.rsplit('.').next().unwrap_or(key);
    let mut header = "";
    for (number, line) in (1..).zip(text.lines()) {
        let is_header = line.trim_start().starts_with('[');
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

/// Without blanks and quotes.
fn bare(line: &str) -> String {
    line.chars().filter(|c| !c.is_whitespace() && !"\"'".contains(*c)).collect()
}
