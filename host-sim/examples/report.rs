//! A page with made-up data: what the report of a run looks like, without a run.
//!
//! `cargo run -p tesaki-sim --example report -- DIR`
#![allow(clippy::cast_precision_loss, reason = "counts of ticks and joints")]

use std::path::PathBuf;

use tesaki_sim::report::{Column, Figure, Line, Metric, Page, Panel, Summary, csv, json, table, write};

const JOINTS: [&str; 3] = ["base", "proximal", "distal"];
const PERIOD: f64 = 0.01;
const TICKS: usize = 600;

/// Reference and error of one joint of one seed.
struct Joint {
    reference: Vec<f64>,
    error: Vec<f64>,
    torque: Vec<f64>,
}

/// A cheap repeatable number between -1 and 1.
fn noise(seed: u64, n: u64) -> f64 {
    let mut x = (seed << 32 | n).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    x ^= x >> 29;
    x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((x >> 40) as f64) / f64::from(1_u32 << 23) - 1.0
}

/// A step of 0.3 rad at 0.5 s and back at 3.5 s through 1/(0.2 s + 1)².
fn joint(seed: u64, index: usize, time: &[f64]) -> Joint {
    let step = |t: f64| if t < 0.0 { 0.0 } else { 1.0 - (1.0 + t / 0.2) * (-t / 0.2).exp() };
    let speed = |t: f64| if t < 0.0 { 0.0 } else { t / 0.04 * (-t / 0.2).exp() };
    let start = [0.05, 0.33, 0.68][index % 3];
    let size = 1.0 + 0.25 * noise(seed, index as u64);
    let sign = if index % 3 == 1 { -1.0 } else { 1.0 };
    let mut joint = Joint { reference: vec![], error: vec![], torque: vec![] };
    for (k, &t) in time.iter().enumerate() {
        let k = k as u64 + 1000 * index as u64;
        let rate = 0.3 * (speed(t - 0.5) - speed(t - 3.5));
        let settle = speed((t - 0.7).max(0.0)) - speed((t - 3.7).max(0.0));
        joint.reference.push(start + 0.3 * (step(t - 0.5) - step(t - 3.5)));
        joint.error.push(sign * size * 1e-3 * (15.0 * rate - 0.9 * settle + 0.12 * noise(seed, k)));
        let gravity = 0.12 / (1.0 + index as f64 % 3.0);
        joint.torque.push(
            gravity
                + 0.08 * rate
                + 0.02 * rate.signum() * f64::from(u8::from(rate.abs() > 1e-3))
                + 2e-3 * noise(seed + 9, k),
        );
    }
    joint
}

fn worst(values: &[f64]) -> (usize, f64) {
    values
        .iter()
        .copied()
        .enumerate()
        .fold((0, 0.0), |a: (usize, f64), b| if b.1.abs() > a.1.abs() { b } else { a })
}

fn summary(seed: u64, joints: &[Joint]) -> Summary {
    let peak = joints.iter().map(|j| worst(&j.error).1.abs()).fold(0.0, f64::max);
    let rest = joints.iter().map(|j| worst(&j.error[250..350]).1.abs()).fold(0.0, f64::max);
    Summary::new("hand3-servo", "qemu", seed)
        .ticks(TICKS as u64)
        .elf_sha256("9f2c41d07be85a3364c0b1f2a7d95e08c4416fa90d3e7b52e1886cf0a2b7d913")
        .identical(true)
        .metric(
            "peak_error",
            Metric::at_most("Peak error against the filtered reference", peak * 1e3, 12.0, "mrad"),
        )
        .metric(
            "rest_error",
            Metric::at_most("Largest error more than 1 s after the step", rest * 1e3, 2.5, "mrad"),
        )
        .metric("torque_peak", Metric::at_most("Largest torque of any joint", 0.262, 0.6, "N·m"))
        .metric(
            "circle_rms",
            Metric::at_most("Fingertip circle, r = 10 mm at 1 Hz, rms", 0.31, 0.5, "mm").paper("1–2 mm"),
        )
        .metric(
            "peak_error_paper_friction",
            Metric::reported("Peak error with 0.08 N·m of Coulomb friction", peak * 2.4e3, "mrad")
                .note("friction of the size the paper's loss implies; reported only"),
        )
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let dir = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("report-demo"), PathBuf::from);
    let time: Vec<f64> = (0..TICKS).map(|k| k as f64 * PERIOD).collect();
    let hand = |seed| (0..9).map(|i| joint(seed, i, &time)).collect::<Vec<_>>();
    let joints = hand(1);
    let several = std::env::args().any(|a| a == "--seeds");
    let summaries: Vec<Summary> =
        (1..=if several { 20 } else { 1 }).map(|seed| summary(seed, &hand(seed))).collect();

    let milli = |v: &[f64]| v.iter().map(|v| v * 1e3).collect::<Vec<_>>();
    let mut angles = Figure::stacked(
        "Step of 0.3 rad, reference and joint",
        "Each joint steps by 0.3 rad at 0.5 s and back at 3.5 s; the reference goes through 1/(T_f s + 1)² with T_f = 0.2 s.",
        "time",
        "s",
    );
    let mut errors = Figure::stacked(
        "Tracking error",
        "Filtered reference minus the plant's true angle. The circle marks the largest error of each finger.",
        "time",
        "s",
    );
    let mut torques =
        Figure::stacked("Torque", "What the servo asked of the motors; the limit is 0.6 N·m.", "time", "s");
    for finger in 0..3 {
        let title = format!("Finger {}", finger + 1);
        let mut angle = Panel::new(&title, "angle", "rad");
        let mut error = Panel::new(&title, "error", "mrad").band(12.0, "limit ±12 mrad").window(
            1.5,
            3.5,
            "more than 1 s after",
        );
        let mut torque = Panel::new(&title, "torque", "N·m").band(0.6, "limit ±0.6 N·m");
        let mut peak: (f64, f64) = (0.0, 0.0);
        for (i, name) in JOINTS.iter().enumerate() {
            let j = &joints[finger * 3 + i];
            let measured = j.reference.iter().zip(&j.error).map(|(r, e)| r - e).collect();
            angle = angle.line(Line::solid(*name, i, time.clone(), measured)).line(Line::dashed(
                if i == 2 { "reference" } else { "" },
                Line::INK,
                time.clone(),
                j.reference.clone(),
            ));
            error = error.line(Line::solid(*name, i, time.clone(), milli(&j.error)));
            torque = torque.line(Line::solid(*name, i, time.clone(), j.torque.clone()));
            let (k, e) = worst(&j.error);
            if e.abs() > peak.1.abs() {
                peak = (time[k], e);
            }
        }
        error = error.mark(peak.0, peak.1 * 1e3, format!("{:.1} mrad", peak.1 * 1e3));
        angles = angles.panel(angle);
        errors = errors.panel(error);
        torques = torques.panel(torque);
    }
    let mut paths =
        Figure::paths("Fingertip paths", "Circle of 10 mm radius at 1 Hz, second turn.", "y", "mm");
    for (finger, size) in [(1, 9.85), (2, 9.9), (3, 10.2)] {
        let at = |r: f64, shift: f64| {
            let phase = (0..=100).map(|k| f64::from(k) * 0.062_832);
            phase.map(|p| (r * (p + shift).cos(), r * p.sin())).unzip::<_, _, Vec<f64>, Vec<f64>>()
        };
        let ((x, y), (rx, ry)) = (at(size, 0.04), at(10.0, 0.0));
        paths = paths.panel(
            Panel::new(format!("Finger {finger}"), "z", "mm")
                .line(Line::dashed("reference", Line::INK, rx, ry))
                .line(Line::solid("tip", 0, x, y)),
        );
    }
    let figures = [errors, angles, torques, paths];
    let command = "cargo sim run hand3-servo --controller qemu --seed 1 --out out/hand3-servo";
    let page = Page::new("Joint servo of the three-finger hand", &summaries)
        .lead(&["Nine joints under the joint servo with a period of 10 ms, on a plant whose masses, inertias, frictions and torque constants differ from the controller's model by up to ±20 %. Made-up data: this page shows what a report looks like."])
        .figures(&figures)
        .reading(&["Errors are measured on the plant's truth, not on the controller's estimate."])
        .command(command)
        .files(&[("series.csv", "all signals, one row a tick"), ("summary.json", "the table, for machines")])
        .html();

    let mut columns = vec![Column::new("time", "s", &time)];
    for (i, j) in joints.iter().enumerate() {
        let name = format!("finger{}_{}", i / 3 + 1, JOINTS[i % 3]);
        columns.push(Column::new(format!("{name} reference"), "rad", &j.reference));
        columns.push(Column::new(format!("{name} error"), "rad", &j.error));
        columns.push(Column::new(format!("{name} torque"), "N·m", &j.torque));
    }
    let files = [("index.html", page), ("series.csv", csv(&columns)), ("summary.json", json(&summaries))];
    let files: Vec<(&str, &str)> = files.iter().map(|(name, text)| (*name, text.as_str())).collect();
    print!("{}", table(&summaries, false));
    for path in write(&dir, &files)? {
        println!(" wrote {}", path.display());
    }
    Ok(())
}
