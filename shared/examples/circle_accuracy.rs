//! Accuracy and times of the circle finder on a set of images as `tests/oracles/find_circle.py set` writes
//! it: `cargo run --release -p tesaki --example circle_accuracy -- DIR [whole|window] [list]`.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    clippy::disallowed_methods,
    reason = "a measurement"
)]

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use tesaki::vision::{CameraBuffers, CircleSearch, Image, Window, find_circle};
use tesaki_output::say;

const SIZE: usize = 256 * 240;

fn median(values: &mut [f32]) -> f32 {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f32::NAN)
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let folder = Path::new(arguments.get(1).ok_or("expected DIR [whole|window] [list]")?);
    let windowed = arguments.iter().any(|argument| argument == "window");
    let list = arguments.iter().any(|argument| argument == "list");
    let read = |name| {
        let file = folder.join(name);
        std::fs::read(&file).map_err(|error| format!("cannot read {}: {error}", file.display()))
    };
    let (images, truth) = (read("images.bin")?, String::from_utf8(read("truth.txt")?)?);
    let mut buffers = Box::new(CameraBuffers::new());
    let (mut centers, mut radii, mut times) = (Vec::new(), Vec::new(), Vec::new());
    let (mut right, mut none) = (0, 0);
    let mut bins = [[0_u32; 2]; 10];
    for (index, (pixels, line)) in images.chunks_exact(SIZE).zip(truth.lines()).enumerate() {
        let row = line.split(' ').map(str::parse).collect::<Result<Vec<f32>, _>>()?;
        if row.len() < 5 {
            return Err(format!("row {index} of truth.txt has {} numbers of at least five", row.len()).into());
        }
        let image = Image::try_new(pixels, 256, 240)?;
        let center = [row[2] + 3.0, row[3] - 2.0];
        let inside = [center[0].clamp(0.0, 254.0), center[1].clamp(0.0, 238.0)];
        let window = windowed.then_some(Window { center: inside, reach: 12.0 });
        let radius = if windowed { [0.85 * row[4], 1.15 * row[4]] } else { [row[0], row[1]] };
        let search = CircleSearch { radius, window, axis: None };
        let mut best = f32::INFINITY;
        let mut found = None;
        for _ in 0..3 {
            let start = Instant::now();
            found = find_circle(&image, &search, &mut buffers.scratch())?;
            best = best.min(start.elapsed().as_secs_f32() * 1e3);
        }
        times.push(best);
        let Some(circle) = found else {
            none += 1;
            if list {
                say!("{index} none; truth {:?}", &row[2..]);
            }
            continue;
        };
        let center = (circle.center[0] - row[2]).hypot(circle.center[1] - row[3]);
        let radius = (circle.radius - row[4]).abs();
        let is_right = center < 0.1 * row[4] && radius < 0.05 * row[4];
        let bin = &mut bins[((circle.confidence * 10.0) as usize).min(9)];
        bin[usize::from(is_right)] += 1;
        if is_right {
            right += 1;
            centers.push(center);
            radii.push(radius);
        } else if list {
            say!("{index} {circle:?}; truth {:?}", &row[2..]);
        }
    }
    let count = times.len();
    say!(
        "{count} images: right {:.4}, none {:.4}, centre {:.3} px, radius {:.3} px, {:.3} ms",
        f64::from(right) / count as f64,
        f64::from(none) / count as f64,
        median(&mut centers),
        median(&mut radii),
        median(&mut times)
    );
    for (bin, [wrong, right]) in bins.iter().enumerate() {
        say!("confidence {:.1}: {right} right, {wrong} wrong", bin as f32 / 10.0);
    }
    Ok(())
}
