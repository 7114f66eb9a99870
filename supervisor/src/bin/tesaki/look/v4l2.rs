//! Cameras of Linux (Video4Linux2).

use std::fmt;
use std::io::{Error, ErrorKind, Result};
use std::path::{Path, PathBuf};

use linuxvideo::format::{PixFormat, PixelFormat};
use linuxvideo::stream::ReadStream;
use linuxvideo::{CapabilityFlags, Device};

use crate::failure::Failure;
use crate::find_circle::Picture;

/// Formats that begin each pixel with its brightness, and their bytes for a pixel; the best first.
const FORMATS: [(&[u8; 4], usize); 2] = [(b"GREY", 1), (b"YUYV", 2)];

/// A camera that gives pictures.
pub struct Camera {
    device: PathBuf,
    stream: ReadStream,
    width: usize,
    height: usize,
    /// Bytes of a pixel, and of a row with its padding.
    bytes: usize,
    stride: usize,
}

impl fmt::Display for Camera {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.device.display().fmt(f)
    }
}

impl Camera {
    /// Starts a camera; it may choose another size than the requested one.
    pub fn open(device: &Path, size: [u32; 2]) -> std::result::Result<Self, Failure> {
        Self::start(device, size).map_err(|error| {
            // What a file that is no V4L2 device answers.
            let is_other = error.raw_os_error() == Some(nix::errno::Errno::ENOTTY as i32);
            let error = if is_other {
                Error::new(
                    ErrorKind::InvalidInput,
                    "it is not a camera; `v4l2-ctl --list-devices` lists them",
                )
            } else {
                error
            };
            Failure::file(device)(error)
        })
    }

    fn start(path: &Path, [width, height]: [u32; 2]) -> Result<Self> {
        for (format, bytes) in FORMATS {
            let device = Device::open(path)?;
            if !device.capabilities()?.device_capabilities().contains(CapabilityFlags::VIDEO_CAPTURE) {
                return Err(Error::new(ErrorKind::InvalidInput, "it is not a camera: it captures no video"));
            }
            let requested = PixelFormat::from_fourcc(*format);
            let camera = device.video_capture(PixFormat::new(width, height, requested))?;
            let got = camera.format();
            let [width, height] = [got.width() as usize, got.height() as usize];
            // Some drivers leave it 0 where there is no padding.
            let stride = (got.bytes_per_line() as usize).max(width * bytes);
            if got.pixel_format() == requested {
                return Ok(Self {
                    device: path.to_owned(),
                    stream: camera.into_stream()?,
                    width,
                    height,
                    bytes,
                    stride,
                });
            }
        }
        Err(Error::new(
            ErrorKind::InvalidInput,
            "it gives neither GREY nor YUYV (`v4l2-ctl --list-formats`): pipe its pictures through ffmpeg, see `tesaki \
             look --help`",
        ))
    }

    /// The next picture.
    pub fn next(&mut self) -> Result<Picture> {
        let Self { width, height, bytes, stride, .. } = *self;
        loop {
            // One that the driver calls damaged is left out.
            let picture = self.stream.dequeue(|view| {
                if view.is_error() {
                    return Ok(None);
                }
                let pixels = brightness(&view, [width, height], bytes, stride)?;
                Ok(Some(Picture { width, height, pixels }))
            })?;
            if let Some(picture) = picture {
                return Ok(picture);
            }
        }
    }
}

/// The brightness of each pixel of a picture whose rows may be padded.
fn brightness(picture: &[u8], [width, height]: [usize; 2], bytes: usize, stride: usize) -> Result<Vec<u8>> {
    // The last row may come without its padding.
    let count = stride * (height - 1) + width * bytes;
    let rows = picture.get(..count).ok_or_else(|| {
        let text = format!("a picture of {} bytes in place of {count}", picture.len());
        Error::new(ErrorKind::InvalidData, text)
    })?;
    let row = |row: &[u8]| row.iter().step_by(bytes).take(width).copied().collect::<Vec<_>>();
    Ok(rows.chunks(stride).flat_map(row).collect())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn padding_of_rows_is_no_part_of_the_picture() {
        // Two rows of two pixels YUYV, padded to six bytes; and without padding.
        let padded = [1, 0, 2, 0, 99, 99, 3, 0, 4, 0, 99, 99];
        assert_eq!(brightness(&padded, [2, 2], 2, 6).unwrap(), [1, 2, 3, 4]);
        assert_eq!(brightness(&padded[..10], [2, 2], 2, 6).unwrap(), [1, 2, 3, 4]);
        assert_eq!(brightness(&[1, 2, 3, 4, 5, 6], [3, 2], 1, 3).unwrap(), [1, 2, 3, 4, 5, 6]);
        let error = brightness(&padded[..9], [2, 2], 2, 6).unwrap_err();
        assert_eq!(error.to_string(), "a picture of 9 bytes in place of 10");
    }
}
