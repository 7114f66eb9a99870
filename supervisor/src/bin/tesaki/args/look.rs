//! Arguments of `tesaki look`.

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use clap::Args;
use tesaki_supervisor::port::Address;

use super::find_circle::{radius, window};

const HELP: &str = "\
Sources:
  -                           binary PGM pictures on standard input, one after the other
  unix://PATH tcp://HOST:PORT the same from a program there, as `cargo sim serve --door`
  files:PATH,PATH             PNG and PGM files, or folders of them, in the order of their numbers
  camera:/dev/video0          a V4L2 camera (Linux) that gives GREY or YUYV
A comment `# age SECONDS` in the header of a PGM picture says how long ago it was exposed.

Examples:
  tesaki look --from files:pictures
  tesaki look --from camera:/dev/video0 --delay 0.05 --to tcp://localhost:7800
  tesaki look --from unix:///tmp/camera --to unix:///tmp/circles
  ffmpeg -f v4l2 -i /dev/video0 -vf crop=ih*16/15:ih,scale=256:240 -pix_fmt gray \\
  -f image2pipe -c:v pgm - | \\
  tesaki look --from - --delay 0.08 --to tcp://localhost:7800";

#[derive(Args)]
#[command(after_help = HELP)]
pub struct Look {
    /// Where the pictures come from
    #[arg(long, value_name = "SOURCE", default_value = "-", allow_hyphen_values = true)]
    pub from: PictureSource,
    /// Address of `tesaki approach`, which says what to look for and gets the circles: unix://PATH or
    /// tcp://HOST:PORT; without it they are printed
    #[arg(long, value_name = "ADDRESS", value_parser = Address::socket)]
    pub to: Option<Address>,
    /// Time from the middle of the exposure to the arrival of a picture that does not tell its age [s]
    #[arg(long, value_name = "S", default_value = "0", value_parser = delay, allow_negative_numbers = true)]
    pub delay: Duration,
    /// Pictures per second, of files
    #[arg(long, value_name = "N", default_value_t = 10.0, value_parser = rate, allow_negative_numbers = true)]
    pub rate: f32,
    /// Expected radius from … to [px], unless `tesaki approach` says it; without it, as in `tesaki
    /// find-circle`
    #[arg(long, value_name = "MIN..MAX", value_parser = radius, allow_hyphen_values = true)]
    pub radius: Option<[f32; 2]>,
    /// Vanishing point (X, Y) of the knob's axis, known to REACH [px], unless `tesaki approach` says it
    #[arg(long, value_name = "X,Y,REACH", value_parser = window, allow_hyphen_values = true)]
    pub axis: Option<[f32; 3]>,
    /// Size of the pictures of a V4L2 camera [px]
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "640x480", value_parser = size)]
    pub size: [u32; 2],
}

/// Source of pictures.
#[derive(Clone, Debug, PartialEq)]
pub enum PictureSource {
    StandardInput,
    Socket(Address),
    Files(Vec<PathBuf>),
    Camera(PathBuf),
}

impl FromStr for PictureSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            _ if text == "-" => Ok(Self::StandardInput),
            Some(("files", paths)) if !paths.is_empty() => {
                Ok(Self::Files(paths.split(',').map(PathBuf::from).collect()))
            }
            Some(("camera", device)) if !device.is_empty() => Ok(Self::Camera(device.into())),
            Some(("unix" | "tcp", _)) => text
                .parse()
                .map(Self::Socket)
                .map_err(|error: tesaki_supervisor::port::AddressError| error.to_string()),
            _ => Err(format!(
                "{text:?} is not a source{hint}: expected -, unix://PATH, tcp://HOST:PORT, files:PATH or camera:/dev/video0",
                hint = guess(text)
            )),
        }
    }
}

/// The probable intention.
fn guess(text: &str) -> String {
    match std::fs::metadata(text) {
        Ok(found) if found.is_file() || found.is_dir() => format!(" (did you mean files:{text}?)"),
        Ok(_) => format!(" (did you mean camera:{text}?)"),
        Err(_) => String::new(),
    }
}

fn delay(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(delay) if (0.0..=1.0).contains(&delay) => Ok(Duration::from_secs_f64(delay)),
        _ => Err(format!("{text}: expected a time from 0 to 1 s")),
    }
}

fn rate(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(rate) if (0.01..=1000.0).contains(&rate) => Ok(rate),
        _ => Err(format!("{text}: expected 0.01 to 1000 pictures a second")),
    }
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once('x').map(|(width, height)| [width, height].map(str::parse));
    match sides {
        Some([Ok(width), Ok(height)]) if width > 0 && height > 0 => Ok([width, height]),
        _ => Err(format!("{text:?}: expected WIDTHxHEIGHT, for example 256x240")),
    }
}
