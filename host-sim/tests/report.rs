//! The report of a run: its content, and that it is well formed for any input.

use std::path::Path;

use tesaki_sim::report::{Figure, Line, Metric, Page, Panel, Summary, figure_files, json, table, write};

fn run(seed: u64, peak: f64) -> Summary {
    Summary::new("hand3-servo", "native", seed)
        .ticks(600)
        .metric(
            "peak_error",
            Metric::at_most("Peak error against the filtered reference", peak, 12.0, "mrad"),
        )
        .metric("held", Metric::at_least("Grasps that hold", 99.5, 99.0, "%").paper("few trials"))
        .metric("drift", Metric::within("Drift in z", -0.15, 0.2, "mm").paper("5 mm"))
        .metric(
            "paper_friction",
            Metric::reported("Peak error, 0.08 N·m of friction", 2.0 * peak, "mrad")
                .note("paper-size friction, reported only"),
        )
}

#[test]
fn table_of_one_seed() {
    let summary = run(7, 8.314).elf_sha256("0123456789abcdef0123").identical(true);
    let expected = "\
\x20hand3-servo  native · seed 7 · 600 ticks · image 0123456789ab · identical to native

 quantity                                    measured      limit       paper  verdict
─────────────────────────────────────────────────────────────────────────────────────────
 Peak error against the filtered reference  8.31 mrad  ≤ 12 mrad           –  ✓ pass
 Grasps that hold                              99.5 %     ≥ 99 %  few trials  ✓ pass
 Drift in z                                 −0.150 mm    ±0.2 mm        5 mm  ✓ pass
 Peak error, 0.08 N·m of friction [1]       16.6 mrad          –           –  · reported

 PASS  3 of 3 limits met
 [1]  paper-size friction, reported only
";
    assert_eq!(table(&[summary], false), expected);
}

#[test]
fn table_of_several_seeds() {
    let summaries = [run(1, 8.0), run(2, 12.004), run(3, 9.5), run(4, f64::NAN)];
    let expected = "\
\x20hand3-servo  native · seeds 1–4 · 4 × 600 ticks

 quantity                                  median   worst (seed)      limit       paper  verdict
────────────────────────────────────────────────────────────────────────────────────────────────────
 Peak error against the filtered        10.8 mrad   NaN mrad (4)  ≤ 12 mrad           –  ✗ FAIL 2/4
 reference
 Grasps that hold                          99.5 %     99.5 % (1)     ≥ 99 %  few trials  ✓ pass
 Drift in z                             −0.150 mm  −0.150 mm (1)    ±0.2 mm        5 mm  ✓ pass
 Peak error, 0.08 N·m of friction [1]   21.5 mrad   NaN mrad (4)          –           –  ✗ FAIL 1/4

 FAIL  2 of 3 limits met, 2 of 4 seeds pass
 [1]  paper-size friction, reported only
";
    assert_eq!(table(&summaries, false), expected);
}

/// Median, worst value and verdict are those of the seeds that have the limit, in any order.
#[test]
fn seeds_without_a_limit_are_told_apart() {
    let motion = |seed: u64, value: f64| {
        Summary::new("weights", "native", seed).metric("motion", Metric::at_most("Motion", value, 0.5, "mm"))
    };
    let mut summaries = [motion(1, 9.0), motion(2, 0.2), motion(3, 8.0), motion(4, 0.4)];
    for weak in [0, 2] {
        summaries[weak].waive("motion", "the hand is too weak");
    }
    let expected = "\
\x20weights  native · seeds 1–4 · 4 × 0 ticks

 quantity      median  worst (seed)     limit  verdict
───────────────────────────────────────────────────────
 Motion [1]  0.300 mm  0.400 mm (4)  ≤ 0.5 mm  ✓ pass

 PASS  1 of 1 limits met, 4 of 4 seeds pass
 [1]  seeds 1, 3: no limit: the hand is too weak
";
    assert_eq!(table(&summaries, false), expected);
    let page = Page::new("Weights", &summaries).html();
    assert!(page.contains("seeds 1, 3: no limit: the hand is too weak"), "{page}");
}

#[test]
fn no_line_is_longer_than_a_hundred_columns() {
    let long = "word ".repeat(60);
    let summary = run(1, 1.0).elf_sha256("f".repeat(64)).metric(
        "long",
        Metric::at_most(&long, 1.0, 2.0, "mrad").note(&long).paper("between 1 and 2 mm, or so"),
    );
    for text in [table(std::slice::from_ref(&summary), false), table(&vec![summary; 3], false)] {
        for line in text.lines() {
            assert!(line.chars().count() <= 100, "{line}");
        }
    }
}

#[test]
fn colours_only_if_asked() {
    let summaries = [run(1, 20.0)];
    let coloured = table(&summaries, true);
    let failed = coloured.lines().find(|line| line.contains("✗ FAIL")).expect("it is over its limit");
    assert!(failed.contains("\x1b[1m") && failed.contains("\x1b[0m"), "{failed:?}");
    assert!(coloured.contains("\x1b[1m hand3-servo"), "{coloured:?}");
    assert!(!table(&summaries, false).contains('\x1b'));
}

#[test]
fn json_of_one_run() {
    let summary = Summary::new("hand3-servo", "native", 7)
        .ticks(600)
        .metric("peak_error", Metric::at_most("Peak", 8.25, 12.0, "mrad"))
        .metric("force", Metric::reported("Force", 0.5, "N").paper("0.89 N"))
        .metric("gap", Metric::reported("Gap", f64::NAN, "mm").note("not in here"));
    let expected = r#"{
  "scenario": "hand3-servo",
  "controller": "native",
  "seed": 7,
  "ticks": 600,
  "metrics": {
    "peak_error": {
      "value": 8.25,
      "unit": "mrad",
      "limit": 12.0,
      "pass": true
    },
    "force": {
      "value": 0.5,
      "unit": "N",
      "limit": null,
      "paper": "0.89 N",
      "pass": true
    },
    "gap": {
      "value": null,
      "unit": "mm",
      "limit": null,
      "pass": false
    }
  },
  "pass": false
}
"#;
    assert_eq!(json(&[summary]), expected);
    let whole = json(&[run(1, 8.0).elf_sha256("ab").identical(true)]);
    assert!(whole.contains("\"elf_sha256\": \"ab\",\n  \"identical\": true,\n  \"metrics\""));
}

#[test]
fn the_paper_has_a_column_where_a_metric_tells_it() {
    let force = || Metric::reported("Force", 0.5, "N");
    let without = [Summary::new("grasp", "native", 1).metric("force", force())];
    let with = [Summary::new("grasp", "native", 1).metric("force", force().paper("0.89 N"))];
    let page = |summaries: &[Summary]| Page::new("Grasp", summaries).html();
    assert!(table(&with, false).contains("paper") && table(&with, false).contains("0.89 N"));
    assert!(page(&with).contains(">Paper</th>") && page(&with).contains(">0.89 N</td>"));
    assert!(json(&with).contains(r#""paper": "0.89 N""#));
    assert!(!table(&without, false).contains("paper") && !json(&without).contains("paper"));
    assert!(!page(&without).contains(">Paper</th>"));
}

#[test]
fn what_is_not_a_number_never_passes() {
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for metric in [
            Metric::reported("", value, ""),
            Metric::at_most("", value, 1.0, ""),
            Metric::at_least("", value, 1.0, ""),
            Metric::within("", value, f64::INFINITY, ""),
        ] {
            assert!(!metric.pass(), "{metric:?}");
        }
        assert!(!Metric::at_most("", 0.0, value, "").pass());
    }
    assert!(!Summary::new("nothing", "native", 1).pass());
    assert!(!run(1, 8.0).identical(false).pass());
}

/// Figures that are hard to draw: markup in names, gaps, limits outside the range, no data, many long lines.
fn awkward() -> Vec<Figure> {
    let time: Vec<f64> = (0..100_000).map(|k| f64::from(k) * 1e-3).collect();
    let wave = |i: i32| time.iter().map(|t| f64::from(i) + (t * f64::from(i + 1)).sin()).collect::<Vec<_>>();
    let mut many = Panel::new("Nine joints & <more>", "error", "mrad")
        .band(12.0, "limit ±12 mrad")
        .rule(7.0, "paper \"7\"");
    for i in 0..9 {
        many = many.line(Line::solid(
            format!("finger {} joint {}", i / 3 + 1, i % 3 + 1),
            0,
            time.clone(),
            wave(i),
        ));
        many.lines.last_mut().expect("a line was added").colour = many.lines.len() - 1;
    }
    let gap: Vec<f64> =
        time.iter().map(|t| if (20.0..30.0).contains(t) { f64::NAN } else { 1e-4 * t }).collect();
    let far = Panel::new("With a gap", "force", "N")
        .line(Line::solid("measured", 0, time.clone(), gap))
        .band(0.6, "limit ±0.6 N")
        .rule(0.009, "paper 9 mN")
        .rule(0.0088, "ours 8.8 mN")
        .mark(99.999, 1e-2, "the last")
        .mark(f64::NAN, 0.0, "nowhere");
    let flat = Panel::new("Flat", "count", "").line(Line::dashed(
        "ticks",
        Line::INK,
        time.clone(),
        vec![1e7; time.len()],
    ));
    let alone = Figure::stacked("One & only", "", "time", "s").panel(
        Panel::new("Modes", "power", "W").line(Line::solid("all", 4, vec![0.0, 1.0], vec![0.0, -1e-7])),
    );
    let empty = Figure::paths("Nothing", "", "x", "mm").panel(Panel::new("Empty", "y", "mm"));
    vec![
        Figure::stacked("Many <lines>", "A & B", "time", "s")
            .phase(-5.0, 40.0, "before & <after>")
            .phase(40.0, 60.0, "weights on")
            .phase(f64::NAN, f64::INFINITY, "nowhere")
            .event(99.99, "the end of a long story")
            .event(f64::NAN, "never")
            .panel(many)
            .panel(far)
            .panel(flat),
        alone,
        empty,
        Figure::paths("None", "", "x", ""),
    ]
}

/// The limit of ±2 lies within the visible range; its lines are dotted.
#[test]
fn a_limit_begins_where_it_applies() {
    let begins = |panel: Panel| {
        let line = Line::solid("", 0, vec![0.0, 10.0], vec![-4.0, 4.0]);
        let svg = Figure::stacked("", "", "time", "s").panel(panel.line(line)).svg();
        let document = roxmltree::Document::parse(&svg).expect("the figure is well formed");
        let number = |text: Option<&str>| {
            let text = text.expect("it has a place").split(',').next().unwrap_or_default();
            text.parse::<f64>().expect("a place is a number")
        };
        let dotted =
            document.descendants().filter(|node| node.attribute("stroke-dasharray") == Some("2 2.5"));
        let lines: Vec<f64> = dotted.map(|node| number(node.attribute("points"))).collect();
        let bands = document.descendants().filter(|node| node.attribute("fill-opacity").is_some());
        let bands: Vec<f64> = bands.map(|node| number(node.attribute("x"))).collect();
        (lines, bands)
    };
    let (whole, whole_bands) = begins(Panel::new("", "", "").band(2.0, "limit"));
    let (half, half_bands) = begins(Panel::new("", "", "").band_from(2.0, 5.0, "limit"));
    assert_eq!((whole.len(), half.len(), whole_bands.len(), half_bands.len()), (2, 2, 1, 1));
    assert_eq!((whole[0], whole_bands[0]), (66.0, 66.0), "the left end of the axes");
    // The axes of 10 s are 860 px wide, minus 66 px at the left and the label's margin at the right.
    let label = 860.0 - 66.0 - 2.0 * (half[0] - 66.0);
    assert!((16.0..80.0).contains(&label), "{label}");
    assert!(half.iter().chain(&half_bands).all(|x| (x - half[0]).abs() < 0.1), "{half:?} {half_bands:?}");
}

#[test]
fn figures_and_page_are_well_formed() {
    let figures = awkward();
    for figure in &figures {
        let svg = figure.svg();
        let document = roxmltree::Document::parse(&svg).unwrap_or_else(|e| panic!("{e}: {}", figure.title));
        assert_eq!(document.root_element().tag_name().name(), "svg");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{}", figure.title);
    }
    let many = figures[0].svg();
    for piece in [
        "<title>Many &lt;lines&gt;</title>",
        "viewBox=\"0 0 860 ",
        "fill=\"#FFFFFF\"",
        "weights on",
        "the end of a long story",
        "stroke=\"#0072B2\"",
        "time [s]",
    ] {
        assert!(many.contains(piece), "{piece}");
    }
    assert!(!many.contains("nowhere") && !many.contains("never"));
    let summaries: Vec<Summary> =
        (1..=20_u32).map(|seed| run(seed.into(), 6.0 + 0.35 * f64::from(seed))).collect();
    let page = Page::new("A <title> & \"more\"", &summaries)
        .lead(&["<script>alert(1)</script>"])
        .figures(&figures)
        .command("cargo sim run x --out 'a&b'")
        .files(&[("series.csv", "a < b")])
        .html();
    assert!(!page.contains("<script>") && page.contains("&lt;script&gt;"));
    let page_of = |at: &str| page.split_once(at).map_or("", |(_, rest)| rest);
    let body = page_of("<body>").split_once("</body>").map_or("", |(body, _)| body);
    roxmltree::Document::parse(body.trim()).expect("the body is well formed");
    assert!(body.contains("href=\"figures/1-many-lines.svg\" download=\"1-many-lines.svg\""));
    let names: Vec<String> = figure_files(&figures).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["1-many-lines.svg", "2-one-only.svg", "3-nothing.svg", "4-none.svg"]);
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR"));
    write(dir, &[("awkward.html", &page)]).expect("the target directory can be written");
}

#[test]
fn a_page_stays_below_two_megabytes() {
    let time: Vec<f64> = (0..60_000).map(|k| f64::from(k) * 1e-2).collect();
    let noisy: Vec<f64> = (0..60_000_u32).map(|k| f64::from(k.wrapping_mul(2_654_435_761) >> 8)).collect();
    let figures: Vec<Figure> = (0..10)
        .map(|_| {
            (0..3).fold(Figure::stacked("", "", "time", "s"), |figure, _| {
                let panel = (0..9).fold(Panel::new("", "", ""), |panel, i| {
                    panel.line(Line::solid(format!("{i}"), i, time.clone(), noisy.clone()))
                });
                figure.panel(panel)
            })
        })
        .collect();
    let page = Page::new("Large", &[]).figures(&figures).html();
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
}

#[test]
fn a_page_with_a_replay_stays_below_five_megabytes() {
    let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand5");
    let robot = tesaki_description::robot::RobotFolder::load(&robot).expect("it is a robot folder");
    let noisy = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 8) / -1e6;
    let contact = |tip: u32| tesaki_viewer::Contact {
        tip: tip as usize,
        point: [noisy(tip); 3],
        force: [noisy(tip + 1); 3],
        normal: [noisy(tip + 2); 3],
        friction: 0.51234,
    };
    let samples: Vec<tesaki_viewer::Sample> = (0..30_000)
        .map(|tick| tesaki_viewer::Sample {
            positions: (0..16).map(|joint| noisy(tick + joint)).collect(),
            velocities: (0..16).map(|joint| noisy(tick + joint + 1)).collect(),
            torques: (0..16).map(|joint| noisy(tick + joint + 2)).collect(),
            references: (0..16).map(|joint| noisy(tick + joint + 3)).collect(),
            frames: Vec::new(),
            contacts: (0..3).map(contact).collect(),
        })
        .collect();
    let scene = tesaki_viewer::Scene::new(&robot.model).with_solids(&robot.urdf);
    let replay = tesaki_viewer::Replay::new(scene, 0.01, &samples);
    let json = tesaki_viewer::script_json(&replay).expect("it is data");
    let page = Page::new("Long", &[]).replay(&json).html();
    // Figures take at most 2 MB.
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
    let (_, rest) = page.split_once(r#"<script type="application/json">"#).expect("the data are there");
    let (data, rest) = rest.split_once("</script>").expect("they end");
    assert_eq!(data, json);
    // The page's script ends with the page.
    assert_eq!(rest.matches("</script>").count(), 1);
    assert!(!Page::new("Without", &[]).html().contains("<script"));
}

#[test]
fn files_are_written_whole_and_errors_say_where() {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("deep/er");
    let paths = write(&dir, &[("a.csv", "1"), ("b.json", "2")]).expect("the target directory can be written");
    assert_eq!(std::fs::read_to_string(&paths[1]).expect("it was written"), "2");
    let left: Vec<_> = std::fs::read_dir(&dir).expect("it is there").collect();
    assert_eq!(left.len(), 2, "{left:?}");

    let error = write(&paths[0], &[("c", "3")]).expect_err("a file is no directory").to_string();
    assert!(error.contains("a.csv") && error.contains("--out"), "{error}");
    let error = write(&dir, &[("../c", "3")]).expect_err("out of the directory").to_string();
    assert!(error.contains("../c"), "{error}");
}
