//! Pictures as grey levels: PNG and PGM.

use std::fs::File;
use std::io::{Cursor, ErrorKind, Read as _};
use std::path::Path;

use crate::failure::Failure;
use crate::feed::read_all;
use crate::output;

/// Most pixels of a picture.
const MAX_PIXELS: usize = 1 << 28;
/// Most bytes of its file. In text a grey level takes four, in a picture that large fewer by far.
const MAX_BYTES: u64 = 1 << 29;
const TOO_LARGE: &str = "more than 268 million pixels: reduce the picture first";

/// Grey levels row by row.
pub struct Picture {
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<u8>,
}

impl Picture {
    /// Reads a PNG or PGM file.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let failed = |error: String| Failure::Other(format!("{}: {error}", path.display()));
        if path.is_dir() {
            return Err(failed("it is a folder: name the pictures in it, such as *.png".to_owned()));
        }
        let mut file = File::open(path).map_err(Failure::file(path))?;
        // A device is not read to an end that it may not have.
        let mut start = Vec::new();
        file.by_ref().take(2).read_to_end(&mut start).map_err(Failure::file(path))?;
        let decode = match &*start {
            b"\x89P" => png,
            b"P5" | b"P2" => pgm,
            _ => return Err(failed("neither a PNG nor a PGM picture: convert it first".to_owned())),
        };
        let bytes = read_all(start.chain(file), MAX_BYTES).map_err(Failure::file(path))?;
        decode(&bytes).map_err(failed)
    }

    /// A picture of PGM, whose grey levels `read` gives: so many, unless the file is cut off.
    pub fn from_pgm(
        width: usize,
        height: usize,
        largest: usize,
        read: impl FnOnce(usize) -> Result<Vec<u8>, String>,
    ) -> Result<Self, String> {
        if !(1..=255).contains(&largest) {
            return Err(format!("PGM: maximum {largest}; only pictures of 8 bits, 1 to 255, can be read"));
        }
        if width == 0 || height == 0 {
            return Err(format!("PGM: {width} × {height} pixels: the picture is empty"));
        }
        let count = width.checked_mul(height).filter(|count| *count <= MAX_PIXELS);
        let count = count.ok_or_else(|| format!("PGM: {width} × {height} pixels: {TOO_LARGE}"))?;
        let levels = read(count).map_err(|error| format!("PGM: {error}"))?;
        if levels.len() != count {
            return Err(format!("PGM: {} of {count} grey levels: the file is cut off", levels.len()));
        }
        if let Some(level) = levels.iter().find(|level| usize::from(**level) > largest) {
            return Err(format!("PGM: a grey level of {level}, above the stated maximum of {largest}"));
        }
        let scaled = |level: u8| u8::try_from(usize::from(level) * 255 / largest).unwrap_or(u8::MAX);
        Ok(Self { width, height, pixels: levels.into_iter().map(scaled).collect() })
    }

    /// The picture reduced `factor` times: means of `factor` × `factor` pixels.
    pub fn reduced(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        let mean = |x: usize, y: usize| {
            let rows = (y * factor..(y + 1) * factor).map(|y| y * self.width + x * factor);
            let sum: usize =
                rows.flat_map(|start| &self.pixels[start..start + factor]).map(|&v| usize::from(v)).sum();
            u8::try_from(sum / (factor * factor)).unwrap_or(u8::MAX)
        };
        let pixels =
            (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| mean(x, y)).collect();
        Self { width, height, pixels }
    }
}

fn png(bytes: &[u8]) -> Result<Picture, String> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let wrong = |error: png::DecodingError| match error {
        png::DecodingError::IoError(error) if error.kind() == ErrorKind::UnexpectedEof => {
            "PNG: the file is cut off".to_owned()
        }
        error => format!("PNG: {error}"),
    };
    let mut reader = decoder.read_info().map_err(wrong)?;
    let size = reader.output_buffer_size().filter(|size| *size <= 4 * MAX_PIXELS);
    let mut buffer = vec![0; size.ok_or_else(|| format!("PNG: {TOO_LARGE}"))?];
    let info = reader.next_frame(&mut buffer).map_err(wrong)?;
    let pixels = &buffer[..info.buffer_size()];
    // Weights of the colours for brightness (ITU-R BT.601), of 256.
    let brightness = |pixel: &[u8]| match pixel {
        [red, green, blue, ..] => {
            let sum = 77 * u32::from(*red) + 150 * u32::from(*green) + 29 * u32::from(*blue);
            u8::try_from(sum >> 8).unwrap_or(u8::MAX)
        }
        [grey, ..] => *grey,
        [] => 0,
    };
    let samples = info.color_type.samples();
    Ok(Picture {
        width: info.width as usize,
        height: info.height as usize,
        pixels: pixels.chunks_exact(samples).map(brightness).collect(),
    })
}

/// The next word of a header, without comments.
fn word<'a>(bytes: &'a [u8], at: &mut usize) -> Option<&'a str> {
    loop {
        while bytes.get(*at)?.is_ascii_whitespace() {
            *at += 1;
        }
        if bytes[*at] != b'#' {
            break;
        }
        while *bytes.get(*at)? != b'\n' {
            *at += 1;
        }
    }
    let start = *at;
    while bytes.get(*at).is_some_and(|byte| !byte.is_ascii_whitespace()) {
        *at += 1;
    }
    std::str::from_utf8(&bytes[start..*at]).ok()
}

fn pgm(bytes: &[u8]) -> Result<Picture, String> {
    let mut at = 2;
    let mut number = |what: &str| {
        let word = word(bytes, &mut at).unwrap_or_default();
        word.parse::<usize>().map_err(|_| format!("PGM: {word:?} is not a {what}"))
    };
    let (width, height, largest) = (number("width")?, number("height")?, number("maximum")?);
    Picture::from_pgm(width, height, largest, |count| {
        if bytes.starts_with(b"P5") {
            let header = bytes.get(at..).unwrap_or_default();
            // One character ends the header, or two as some programs write them.
            let ends_in_two = header.starts_with(b"\r\n") && header.len() == count + 2;
            Ok(header.iter().skip(if ends_in_two { 2 } else { 1 }).take(count).copied().collect())
        } else {
            let level = |word: &str| {
                word.parse().map_err(|_| format!("{word:?} is not a grey level, 0 to {largest}"))
            };
            (0..count).map_while(|_| word(bytes, &mut at).map(level)).collect()
        }
    })
}

/// Writes a picture in colour: red, green, blue of each pixel.
pub fn write_png(path: &Path, width: usize, height: usize, pixels: &[u8]) -> Result<(), Failure> {
    let wrong = |error: &dyn std::fmt::Display| Failure::Other(format!("{}: {error}", path.display()));
    let (width, height) = match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width), Ok(height)) => (width, height),
        _ => return Err(wrong(&"the picture is too large")),
    };
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(|error| wrong(&error))?;
    writer.write_image_data(pixels).map_err(|error| wrong(&error))?;
    writer.finish().map_err(|error| wrong(&error))?;
    output::replace(path, file).map_err(Failure::written(path))
}
