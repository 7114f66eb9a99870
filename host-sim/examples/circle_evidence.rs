//! What the circle finder knows of pictures of door knobs, for the fits in `tests/oracles`:
//! `cargo run --release -p tesaki-sim --features tesaki/test-support --example circle_evidence -- KIND WHAT`
//!
//! WHAT is a range of machines of the scenario `knob-find`, such as `21-160`, or a folder that
//! `tests/oracles/find_circle.py set` wrote, in which the axis of the knob is not known.
//!
//! KIND `candidates`, for `circle_choice.py`: a row of CSV for each candidate: machine (of a folder 0) and
//! picture; what is wrong with the ellipse that is judged and with its fit to the edge in fine steps
//! [px], empty where there is no rose; the ellipse that is judged [px]; features of the circle; features of
//! the end of a knob before it, empty where none is known.
//!
//! KIND `rays`, for `rim_offset.py`: a row of little-endian `f32` for each ray on which the chosen rim can be
//! seen, of pictures with a rose and a confidence of at least 0.5: machine and picture; semi-axes [px] and
//! angle [rad] of the true ellipse, and its centre relative to that of the ellipse from which the ray starts
//! [px]; the ray's direction and the distance of that ellipse along it [px]; the network's inputs.

#![allow(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "a measurement")]

use std::error::Error;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use tesaki::vision::{CameraBuffers, CircleSearch, Evidence, Image, RimRay, evidence, rim_rays};
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

/// Pictures whose circle is less certain show no rim to learn from.
const CERTAIN: f32 = 0.5;

/// True ellipse of a rim [px, rad].
#[derive(Clone, Copy)]
struct Truth {
    center: [f64; 2],
    semi_axes: [f64; 2],
    angle: f64,
}

/// A picture with its machine and number.
struct Picture<'a> {
    seed: u64,
    number: usize,
    image: Image<'a>,
    search: CircleSearch,
    truth: Option<Truth>,
}

type Answer = Result<(), Box<dyn Error>>;

fn main() -> Answer {
    match run() {
        // The reader of the pipe has all that it needs.
        Err(error)
            if error
                .downcast_ref::<io::Error>()
                .is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe) =>
        {
            Ok(())
        }
        result => result,
    }
}

fn run() -> Answer {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [kind, what] = arguments.as_slice() else {
        return Err("expected `candidates` or `rays`, and machines, such as 21-160, or a folder".into());
    };
    let (mut out, mut buffers) = (BufWriter::new(io::stdout().lock()), Box::<CameraBuffers>::default());
    match kind.as_str() {
        "candidates" => {
            writeln!(out, "{COLUMNS}")?;
            each(what, |picture| candidates(&mut out, &mut buffers, picture))?;
        }
        "rays" => each(what, |picture| rays(&mut out, &mut buffers, picture))?,
        other => return Err(format!("expected `candidates` or `rays`, not `{other}`").into()),
    }
    Ok(out.flush()?)
}

/// Calls `seen` with all pictures of machines or of a folder.
fn each(what: &str, mut seen: impl FnMut(&Picture<'_>) -> Answer) -> Answer {
    let range = what.split_once('-').and_then(|(from, to)| Some((from.parse().ok()?, to.parse().ok()?)));
    if let Some((from, to)) = range {
        let robot = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/knob-arm"));
        let values = CameraValues::load(robot)?;
        for seed in from..=to {
            for (number, picture) in KnobPictures::new(values, seed, PICTURES).enumerate() {
                let truth = picture.truth.map(|truth| Truth {
                    center: truth.center,
                    semi_axes: truth.semi_axes,
                    angle: truth.angle,
                });
                let image = Image::try_new(&picture.image.pixels, picture.image.width, picture.image.height)?;
                seen(&Picture { seed, number, image, search: picture.search, truth })?;
            }
        }
        return Ok(());
    }
    let folder = Path::new(what);
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
        return Err(format!("{what}: images.bin has {bytes} bytes; its truth.txt needs {expected}").into());
    }
    for (number, (pixels, row)) in pixels.chunks_exact(WIDTH * HEIGHT).zip(rows.lines()).enumerate() {
        let row = row.split(' ').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
        let &[from, to, x, y, _, a, b, angle] = &row[..] else {
            return Err(format!("{what}: row {number} of truth.txt needs eight numbers").into());
        };
        let search =
            CircleSearch { radius: [from, to].map(|radius| radius as f32), window: None, axis: None };
        let truth = Some(Truth { center: [x, y], semi_axes: [a, b], angle });
        seen(&Picture { seed: 0, number, image: Image::try_new(pixels, WIDTH, HEIGHT)?, search, truth })?;
    }
    Ok(())
}

/// A row for each candidate in a picture.
fn candidates(out: &mut impl Write, buffers: &mut CameraBuffers, picture: &Picture<'_>) -> Answer {
    let mut candidates = Vec::new();
    evidence(&picture.image, &picture.search, &mut buffers.scratch(), |candidate| {
        candidates.push(candidate)
    })?;
    for candidate in &candidates {
        let Evidence { center, radius, fine_center, fine_radius, features, behind, .. } = candidate;
        let mut row = vec![picture.seed.to_string(), picture.number.to_string()];
        for (center, radius) in [(center, radius), (fine_center, fine_radius)] {
            row.extend(match &picture.truth {
                Some(Truth { center: [x, y], semi_axes: [a, b], .. }) => {
                    let [dx, dy] = [f64::from(center[0]) - x, f64::from(center[1]) - y];
                    [dx.hypot(dy), f64::from(*radius) - (a * b).sqrt()].map(|error| format!("{error:.5}"))
                }
                None => Default::default(),
            });
        }
        row.extend([center[0], center[1], *radius].iter().chain(features).map(f32::to_string));
        match behind {
            Some(features) => row.extend(features.iter().map(f32::to_string)),
            None => row.extend([const { String::new() }; 12]),
        }
        writeln!(out, "{}", row.join(","))?;
    }
    Ok(())
}

/// A row for each ray on which the chosen rim can be seen.
fn rays(out: &mut impl Write, buffers: &mut CameraBuffers, picture: &Picture<'_>) -> Answer {
    let Some(Truth { center, semi_axes: [a, b], angle }) = picture.truth else { return Ok(()) };
    let mut rays = Vec::new();
    let found = rim_rays(&picture.image, &picture.search, &mut buffers.scratch(), |ray| rays.push(ray))?;
    if !found.is_some_and(|confidence| confidence >= CERTAIN) {
        return Ok(());
    }
    for RimRay { center: [x, y], direction, polar_radius, inputs } in rays {
        let [dx, dy] = [center[0] - f64::from(x), center[1] - f64::from(y)];
        let truth = [a, b, angle, dx, dy].map(|value| value as f32);
        let row = [picture.seed as f32, picture.number as f32].into_iter().chain(truth);
        for value in row.chain(direction).chain([polar_radius]).chain(inputs) {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}
