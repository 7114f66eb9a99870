//! Lines of TOML files.

/// The line where `key` (with its tables, or their end) has its value or starts a table.
pub fn line_of(text: &str, key: &str) -> Option<usize> {
    let mut header = String::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line: String = line.chars().filter(|c| !c.is_whitespace() && !"\"'".contains(*c)).collect();
        let here = match line.strip_prefix('[').and_then(|line| line.split(']').next()) {
            Some(name) => {
                header = format!(".{name}");
                header.clone()
            }
            None => match line.split_once('=') {
                Some((name, _)) if !name.starts_with('#') => format!("{header}.{name}"),
                _ => continue,
            },
        };
        if here.ends_with(&format!(".{key}")) || here.contains(&format!(".{key}.")) {
            return Some(number);
        }
    }
    None
}
