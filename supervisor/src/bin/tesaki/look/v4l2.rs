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
    bytes: usize,
}

impl fmt::Display for Camera {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.device.display().fmt(f)
    }
}

impl Camera {
    /// Starts a camera; it may choose another size than the wanted one.
    pub fn open(device: &Path, size: [u32; 2]) -> std::result::Result<Self, Failure> {
        Self::start(device, size).map_err(Failure::file(device))
    }

    fn start(path: &Path, [width, height]: [u32; 2]) -> Result<Self> {
        for (format, bytes) in FORMATS {
            let device = Device::open(path)?;
            if !device.capabilities()?.device_capabilities().contains(CapabilityFlags::VIDEO_CAPTURE) {
                return Err(Error::new(ErrorKind::InvalidInput, "it is no camera: it captures no video"));
            }
            let wanted = PixelFormat::from_fourcc(*format);
            let camera = device.video_capture(PixFormat::new(width, height, wanted))?;
            let got = camera.format();
            let [width, height] = [got.width() as usize, got.height() as usize];
            if got.pixel_format() == wanted {
                return Ok(Self {
                    device: path.to_owned(),
                    stream: camera.into_stream()?,
                    width,
                    height,
                    bytes,
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
        let Self { width, height, bytes, .. } = *self;
        loop {
            // One that the driver calls damaged is left out.
            let picture = self.stream.dequeue(|view| {
                let count = width * height * bytes;
                if view.is_error() {
                    return Ok(None);
                }
                let pixels = view.get(..count).ok_or_else(|| {
                    let text = format!("a picture of {} bytes in place of {count}", view.len());
                    Error::new(ErrorKind::InvalidData, text)
                })?;
                Ok(Some(Picture { width, height, pixels: pixels.iter().step_by(bytes).copied().collect() }))
            })?;
            if let Some(picture) = picture {
                return Ok(picture);
            }
        }
    }
}
