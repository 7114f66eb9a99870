//! Texts that are expensive to read: nested, expanding, wide.

/// Returns XML of about `size` bytes, of each kind.
pub fn urdfs(size: usize) -> Vec<String> {
    let robot = |inside: &str| format!("<robot name=\"r\">{inside}</robot>");
    let entities: String =
        (1..10).map(|n| format!("<!ENTITY e{n} \"{}\">", format!("&e{};", n - 1).repeat(10))).collect();
    let links = |count: usize| (0..count).map(|n| format!("<link name=\"l{n}\"/>")).collect::<String>();
    let joint = |n: usize, parent: usize, child: usize| {
        format!(
            "<joint name=\"j{n}\" type=\"revolute\"><parent link=\"l{parent}\"/><child link=\"l{child}\"/><axis \
             xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" velocity=\"1\" effort=\"1\"/></joint>"
        )
    };
    let count = size / 190;
    let chain: String = (1..count).map(|n| joint(n, n - 1, n)).collect();
    let star: String = (1..count).map(|n| joint(n, 0, n)).collect();
    // A chain with a branch at every link.
    let comb: String = (1..count).map(|n| joint(n, if n % 2 == 1 { n - 1 } else { n - 2 }, n)).collect();
    let ring = joint(1, 0, 1) + &joint(2, 1, 0);
    vec![
        "<a>".repeat(size / 3),
        robot(&("<link>".repeat(size / 13) + &"</link>".repeat(size / 13))),
        format!("<!DOCTYPE r [<!ENTITY e0 \"laugh\">{entities}]>{}", robot("&e9;")),
        format!("<!DOCTYPE r [<!ENTITY e0 \"1\">{entities}]><robot name=\"&e9;\"/>"),
        robot(&(links(count) + &chain)),
        robot(&(links(count) + &star)),
        robot(&(links(count) + &comb)),
        robot(&(links(2) + &ring)),
        robot(&format!(
            "<link {}/>",
            (0..size / 8).map(|n| format!("a{n}=\"\"")).collect::<Vec<_>>().join(" ")
        )),
        robot(&format!("<link name=\"{}\"/>", "n".repeat(size))),
        robot(&format!("<link name=\"a\"><origin xyz=\"{}\"/></link>", "1 ".repeat(size / 2))),
        robot("<link name=\"l0\"/>").repeat(size / 40),
        "\n".repeat(size) + &robot(""),
    ]
}

/// Returns TOML of about `size` bytes, of each kind.
pub fn tomls(size: usize) -> Vec<String> {
    vec![
        format!("gravity = {}", "[".repeat(size)),
        format!("gravity = {}{}", "[".repeat(size / 2), "]".repeat(size / 2)),
        format!("gravity = {}", "{a=".repeat(size / 3)),
        format!("{}a = 1", "a.".repeat(size / 2)),
        format!("[{}a]", "a.".repeat(size / 2)),
        format!("gravity = [{}]", "0,".repeat(size / 2)),
        (0..size / 8).map(|n| format!("k{n} = 1\n")).collect(),
        (0..size / 8).map(|n| format!("[t{n}]\n")).collect(),
        "[[a]]\n".repeat(size / 6),
        format!("a = \"{}\"", "x".repeat(size)),
        format!("a = {}", "9".repeat(size)),
        "\n".repeat(size),
    ]
}
