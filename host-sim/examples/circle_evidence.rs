//! What the circle finder weighs in pictures of door knobs, for `tests/oracles/circle_choice.py`:
//! `cargo run --release -p tesaki-sim --features tesaki/test-support --example circle_evidence -- WHAT`
//!
//! WHAT is a range of machines of the scenario `knob-find`, such as `21-160`, or a folder that
//! `tests/oracles/find_circle.py set` wrote, in which the axis of the knob is not known. Prints a row of CSV
//! for each candidate: machine (of a folder 0) and picture; what is wrong with the ellipse that is judged and
//! with the one that is returned if it is chosen [px], empty where there is no rose; the ellipse that is
//! judged [px]; features of the circle; features of the end of a knob before it, empty where none is known.

#![allow(clippy::cast_possible_truncation, reason = "a measurement")]

use std::error::Error;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use tesaki::vision::{CameraBuffers, CircleSearch, Evidence, Image, evidence};
use tesaki_sim::camera::CameraValues;
use tesaki_sim::scenario::KnobPictures;

const COLUMNS: &str = "machine,picture,center_error,radius_error,fine_center_error,fine_radius_error,x,y,radius,\
                       constant,open,contrast,common,near_in,near_out,far_in,sharp,shade_in,shade,shade_out,\
                       jitter,gap,flattening,place,place_squared,\
                       knob_contrast,knob_common,knob_near_in,knob_near_out,knob_sharp,knob_jitter,knob_gap,\
                       size,size_squared,aside,depth,depth_squared";
/// Pictures of a machine.
const PICTURES: usize = 60;
const WIDTH: usize = 256;
const HEIGHT: usize = 240;

fn main() -> Result<(), Box<dyn Error>> {
    let what = std::env::args().nth(1).ok_or("expected machines, such as 21-160, or a folder")?;
    let mut table = Table { out: BufWriter::new(io::stdout().lock()), buffers: Box::default() };
    writeln!(table.out, "{COLUMNS}")?;
    let range = what.split_once('-').and_then(|(from, to)| Some((from.parse().ok()?, to.parse().ok()?)));
    if let Some((from, to)) = range {
        let robot = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/knob-arm"));
        let values = CameraValues::load(robot)?;
        for seed in from..=to {
            for (number, picture) in KnobPictures::new(values, seed, PICTURES).enumerate() {
                let truth = picture.truth.map(|truth| [truth.center[0], truth.center[1], truth.radius]);
                let image = Image::new(&picture.image.pixels, picture.image.width, picture.image.height)?;
                table.append((seed, number), &image, &picture.search, truth)?;
            }
        }
    } else {
        let folder = Path::new(&what);
        let read = |name| {
            let file = folder.join(name);
            std::fs::read(&file).map_err(|error| {
                let file = file.display();
                format!("cannot read {file}: {error}; {what} is no range of machines, such as 21-160, either")
            })
        };
        let (pixels, rows) = (read("images.bin")?, String::from_utf8(read("truth.txt")?)?);
        let (bytes, expected) = (pixels.len(), rows.lines().count() * WIDTH * HEIGHT);
        if bytes != expected {
            return Err(
                format!("{what}: images.bin has {bytes} bytes; its truth.txt needs {expected}").into()
            );
        }
        for (number, (pixels, row)) in pixels.chunks_exact(WIDTH * HEIGHT).zip(rows.lines()).enumerate() {
            let row = row.split(' ').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
            let &[from, to, x, y, radius] = &row[..] else {
                return Err(format!("{what}: row {number} of truth.txt needs five numbers").into());
            };
            let search =
                CircleSearch { radius: [from, to].map(|radius| radius as f32), window: None, axis: None };
            table.append((0, number), &Image::new(pixels, WIDTH, HEIGHT)?, &search, Some([x, y, radius]))?;
        }
    }
    Ok(table.out.flush()?)
}

struct Table<W: Write> {
    out: W,
    buffers: Box<CameraBuffers>,
}

impl<W: Write> Table<W> {
    /// A row for each candidate in a picture.
    fn append(
        &mut self,
        (seed, number): (u64, usize),
        image: &Image<'_>,
        search: &CircleSearch,
        truth: Option<[f64; 3]>,
    ) -> Result<(), Box<dyn Error>> {
        let mut candidates = Vec::new();
        evidence(image, search, &mut self.buffers.scratch(), |candidate| candidates.push(candidate))?;
        for candidate in &candidates {
            let Evidence { center, radius, fine_center, fine_radius, features, behind, .. } = candidate;
            let mut row = vec![seed.to_string(), number.to_string()];
            for (center, radius) in [(center, radius), (fine_center, fine_radius)] {
                row.extend(match truth {
                    Some([true_x, true_y, true_radius]) => {
                        let [dx, dy] = [f64::from(center[0]) - true_x, f64::from(center[1]) - true_y];
                        [dx.hypot(dy), f64::from(*radius) - true_radius].map(|error| format!("{error:.5}"))
                    }
                    None => Default::default(),
                });
            }
            row.extend([center[0], center[1], *radius].iter().chain(features).map(f32::to_string));
            match behind {
                Some(features) => row.extend(features.iter().map(f32::to_string)),
                None => row.extend([const { String::new() }; 12]),
            }
            writeln!(self.out, "{}", row.join(","))?;
        }
        Ok(())
    }
}
