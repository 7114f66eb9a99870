//! `tesaki find-circle` on pictures drawn by the test.

use std::path::Path;

use serde_json::Value;

/// Runs the command; returns exit code, standard output and standard error.
fn run(arguments: &[&str]) -> (i32, String, String) {
    let output = tesaki_tests::tesaki().args(arguments).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

/// Writes a grey picture with a dark disc as PGM.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "grey levels")]
fn disc(path: &Path, [width, height]: [u32; 2], [x, y, radius]: [f64; 3]) {
    let mut bytes = format!("P5\n# a disc\n{width} {height}\n255\n").into_bytes();
    for row in 0..height {
        for column in 0..width {
            let away = (f64::from(column) - x).hypot(f64::from(row) - y) - radius;
            bytes.push(if away < -0.5 {
                60
            } else if away > 0.5 {
                160
            } else {
                (110.0 + 100.0 * away) as u8
            });
        }
    }
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_disc_is_found_told_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let (small, large) = (folder.path().join("small.pgm"), folder.path().join("large.pgm"));
    disc(&small, [256, 240], [100.25, 120.5, 40.0]);
    disc(&large, [2000, 1500], [1200.0, 700.5, 300.0]);
    let [small, large] = [&small, &large].map(|path| path.to_str().unwrap());
    let (code, out, error) = run(&["find-circle", small, large]);
    assert!(code == 0 && error.is_empty(), "{error}");
    assert!(out.contains("small.pgm: centre (100.2") && out.contains("large.pgm: centre (1"), "{out}");
    let (_, out, _) = run(&["--json", "find-circle", small, large]);
    let value: Value = serde_json::from_str(&out).unwrap();
    for (image, [x, y, radius, error]) in [(0, [100.25, 120.5, 40.0, 0.1]), (1, [1200.0, 700.5, 300.0, 0.5])]
    {
        let circle = &value["images"][image]["circle"];
        let found =
            [&circle["center"][0], &circle["center"][1], &circle["radius"]].map(|v| v.as_f64().unwrap());
        assert!(
            found.iter().zip([x, y, radius]).all(|(found, truth)| (found - truth).abs() < error),
            "{out}"
        );
        assert!(circle["confidence"].as_f64().unwrap() > 0.9, "{out}");
    }
    let drawn = folder.path().join("drawn.png");
    let (code, _, error) = run(&["find-circle", small, "--annotate", drawn.to_str().unwrap()]);
    assert_eq!(code, 0, "{error}");
    // The annotated picture can be read again, and still contains the circle.
    let (code, out, error) =
        run(&["find-circle", drawn.to_str().unwrap(), "--radius", "35..45", "--window", "100,120,5"]);
    assert!(code == 0 && (out.contains("radius 40.") || out.contains("radius 39.")), "{out}{error}");
    let (_, out, _) = run(&["find-circle", small, "--radius", "60..80"]);
    assert!(out.contains("small.pgm: no circle"), "{out}");
}

#[test]
fn what_is_wrong_is_said_by_file() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let cases = [
        (write("text.png", b"hello"), "text.png: neither a PNG nor a PGM picture"),
        (write("cut.png", b"\x89PNG\r\n\x1a\n\0\0"), "cut.png: PNG: the file is cut off"),
        (write("huge.pgm", b"P5 99999 99999 255\n"), "99999 × 99999 pixels: more than 268 million pixels"),
        (write("cut.pgm", b"P5 64 64 255\nabc"), "cut.pgm: PGM: 3 of 4096 grey levels: the file is cut off"),
        (write("deep.pgm", b"P5 64 64 65535\nabc"), "deep.pgm: PGM: maximum 65535"),
        (write("none.pgm", b"P5 0 0 255\n"), "none.pgm: PGM: 0 × 0 pixels: the picture is empty"),
        (write("flat.pgm", b"P2 64 0 255\n"), "flat.pgm: PGM: 64 × 0 pixels: the picture is empty"),
        (write("word.pgm", b"P2 wide 64 255\n"), "word.pgm: PGM: \"wide\" is not a width"),
        (write("tiny.pgm", b"P2 2 2 255\n1 2 3 4\n"), "each side must be 32 to 4096 pixels"),
        (
            folder.path().to_str().unwrap().to_owned(),
            "it is a folder: name the pictures in it, such as *.png",
        ),
        (folder.path().join("none.png").to_str().unwrap().to_owned(), "none.png: "),
    ];
    for (path, words) in cases {
        let (code, out, error) = run(&["find-circle", &path]);
        assert!(code == 1 && out.is_empty() && error.contains(words), "{words}: {code} {error}");
    }
    let black = write("black.pgm", &[b"P5 64 64 255\n".to_vec(), vec![0; 4096]].concat());
    let (code, _, error) = run(&["find-circle", &black, "--radius", "2..20"]);
    assert!(
        code == 1 && error.contains("black.pgm: expected radius of 2 to 20 pixels: the limits are 5 to"),
        "{error}"
    );
    // Of a large picture, limits are told in its own pixels.
    let wide = write("wide.pgm", &[b"P5 5000 40 255\n".to_vec(), vec![0; 200_000]].concat());
    let (code, _, error) = run(&["find-circle", &wide]);
    let words = "wide.pgm: a picture of 5000 × 40 pixels: with a side of more than 1000 it is reduced, 5 times, to \
                 1000 × 8, and each side must then have at least 32: cut out";
    assert!(code == 1 && error.contains(words), "{error}");
    let large = write("large.pgm", &[b"P5 2000 400 255\n".to_vec(), vec![0; 800_000]].concat());
    let (code, _, error) = run(&["find-circle", &large, "--radius", "8..60"]);
    assert!(code == 1 && error.contains("4 to 30 pixels") && error.contains("times 2, these are"), "{error}");
    // One bad file does not suppress the results of others.
    let folder_of = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let good = folder_of("good.pgm");
    disc(Path::new(&good), [256, 240], [100.25, 120.5, 40.0]);
    let (code, out, error) = run(&["find-circle", &folder_of("cut.pgm"), &good, &folder_of("text.png")]);
    assert!(code == 1 && out.contains("good.pgm: centre (100.2"), "{code} {out}");
    assert!(error.contains("cut.pgm: PGM: 3 of 4096") && error.contains("text.png: neither"), "{error}");
    // A header that ends with two characters, as some programs write it.
    let crlf: Vec<u8> = std::fs::read(&good).unwrap();
    let (header, pixels) = crlf.split_at(crlf.len() - 256 * 240);
    let header = String::from_utf8(header.to_vec()).unwrap().replace('\n', "\r\n");
    let (code, out, _) = run(&["find-circle", &write("crlf.pgm", &[header.as_bytes(), pixels].concat())]);
    assert!(code == 0 && out.contains("crlf.pgm: centre (100.2"), "{code} {out}");
    // The annotated picture does not overwrite the original.
    let before = std::fs::read(&good).unwrap();
    let (code, _, error) = run(&["find-circle", &good, "--annotate", &good]);
    assert!(code == 2 && error.contains("IMAGE and --annotate are both"), "{code} {error}");
    assert_eq!(std::fs::read(&good).unwrap(), before);
    for arguments in [["--radius", "-5..20"], ["--radius", "0..20"]] {
        let (code, _, error) = run(&[&["find-circle", &black][..], &arguments].concat());
        assert!(code == 2 && error.contains("px, is not above 0: for example 20..60"), "{error}");
    }
    let (code, _, error) = run(&["find-circle", &black, "--window", "-5,10,10"]);
    assert!(
        code == 1 && error.contains("window of 10 pixels around (-5, 10): the centre must lie"),
        "{error}"
    );
    for arguments in
        [["--radius", "20"], ["--radius", "30..20"], ["--window", "1,2"], ["--annotate", "x.png"]]
    {
        let (code, _, error) = run(&[&["find-circle", &black, &black][..], &arguments].concat());
        assert!(code == 2 && error.contains(arguments[0].trim_start_matches("--")), "{error}");
    }
}
