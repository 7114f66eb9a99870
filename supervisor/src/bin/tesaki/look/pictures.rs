//! Sources of pictures: a stream of PGM on standard input or a socket, and files.

use std::io::{self, BufRead, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tesaki_supervisor::port::{Address, connect};

use crate::args::{Look, PictureSource};
use crate::failure::Failure;
use crate::find_circle::Picture;

/// A socket that nobody listens at is tried again after this time.
const AGAIN: Duration = Duration::from_millis(200);
/// Longest header of a PGM picture [bytes].
const MAX_HEADER: usize = 1 << 10;

/// A picture, and when it was exposed.
pub struct Taken {
    pub picture: Picture,
    pub exposed: Instant,
    /// For messages.
    pub name: String,
}

/// What has come of a source.
#[derive(Default)]
struct State {
    next: Option<Taken>,
    /// Pictures that another one has replaced before they were looked at.
    skipped: u64,
    /// What is wrong with a source that goes on.
    trouble: Option<String>,
    /// How the source has ended.
    ended: Option<Result<(), String>>,
}

/// The newest picture of a source, which is read in a thread of its own.
#[derive(Clone, Default)]
pub struct Pictures(Arc<(Mutex<State>, Condvar)>);

impl Pictures {
    pub fn open(args: &Look) -> Result<Self, Failure> {
        let pictures = Self::default();
        let (inlet, delay) = (pictures.clone(), args.delay);
        match &args.from {
            PictureSource::StandardInput => {
                std::thread::spawn(move || {
                    let ended = inlet.stream(&mut io::stdin().lock(), delay);
                    inlet.end(ended.map_err(|error| format!("standard input: {error}")));
                });
            }
            PictureSource::Socket(address) => {
                let address = address.clone();
                std::thread::spawn(move || inlet.socket(&address, delay));
            }
            PictureSource::Files(paths) => {
                let (files, period) = (files(paths)?, Duration::from_secs_f32(1.0 / args.rate));
                std::thread::spawn(move || {
                    let ended = inlet.play(&files, period);
                    inlet.end(ended.map_err(|failure| failure.to_string()));
                });
            }
            #[cfg(target_os = "linux")]
            PictureSource::Camera(device) => {
                let mut camera = super::v4l2::Camera::open(device, args.size)?;
                std::thread::spawn(move || {
                    let ended = inlet.film(&mut camera, delay);
                    inlet.end(ended.map_err(|error| format!("{camera}: {error}")));
                });
            }
            #[cfg(not(target_os = "linux"))]
            PictureSource::Camera(_) => {
                let error = "V4L2 cameras are those of Linux: pipe the pictures (`tesaki look --help`)";
                return Err(Failure::Usage(error.to_owned()));
            }
        }
        Ok(pictures)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next picture, if one comes within this time.
    pub fn next(&self, within: Duration) -> Option<Taken> {
        let waits = |state: &mut State| state.next.is_none() && state.ended.is_none();
        let waited = self.0.1.wait_timeout_while(self.state(), within, waits);
        let taken = waited.unwrap_or_else(PoisonError::into_inner).0.next.take();
        // A file waits for its place.
        self.0.1.notify_all();
        taken
    }

    /// What is wrong with the source, told once.
    pub fn trouble(&self) -> Option<String> {
        self.state().trouble.take()
    }

    /// Pictures that were not looked at.
    pub fn skipped(&self) -> u64 {
        self.state().skipped
    }

    /// How the source has ended, once its last picture was taken.
    pub fn ending(&self) -> Option<Result<(), String>> {
        let state = self.state();
        state.ended.clone().filter(|_| state.next.is_none())
    }

    fn put(&self, taken: Taken) {
        let mut state = self.state();
        state.skipped += u64::from(state.next.replace(taken).is_some());
        self.0.1.notify_all();
    }

    fn end(&self, ended: Result<(), String>) {
        self.state().ended = Some(ended);
        self.0.1.notify_all();
    }

    /// Puts in the pictures of a stream, up to its end.
    fn stream(&self, input: &mut impl BufRead, delay: Duration) -> io::Result<()> {
        for number in 0_u64.. {
            let Some((picture, begun, age)) = read_pgm(input)? else { break };
            let exposed = begun.checked_sub(age.unwrap_or(delay)).unwrap_or(begun);
            self.put(Taken { picture, exposed, name: format!("picture {number}") });
        }
        Ok(())
    }

    /// The same of a socket, again and again.
    fn socket(&self, address: &Address, delay: Duration) {
        loop {
            let error = match connect(address) {
                Ok(socket) => match self.stream(&mut BufReader::new(socket), delay) {
                    Ok(()) => "the camera has closed the connection".to_owned(),
                    Err(error) => error.to_string(),
                },
                Err(error) => error.to_string(),
            };
            self.state().trouble = Some(format!("{address}: {error}; it is tried again"));
            std::thread::sleep(AGAIN);
        }
    }

    /// Puts in the pictures of a camera.
    #[cfg(target_os = "linux")]
    fn film(&self, camera: &mut super::v4l2::Camera, delay: Duration) -> io::Result<()> {
        for number in 0_u64.. {
            let picture = camera.next()?;
            let now = Instant::now();
            let exposed = now.checked_sub(delay).unwrap_or(now);
            self.put(Taken { picture, exposed, name: format!("picture {number}") });
        }
        Ok(())
    }

    /// Puts in the pictures of files, each once the one before is looked at.
    fn play(&self, files: &[PathBuf], period: Duration) -> Result<(), Failure> {
        for path in files {
            let picture = Picture::read(path)?;
            let waits = |state: &mut State| state.next.is_some();
            drop(self.0.1.wait_while(self.state(), waits).unwrap_or_else(PoisonError::into_inner));
            self.put(Taken { picture, exposed: Instant::now(), name: path.display().to_string() });
            std::thread::sleep(period);
        }
        Ok(())
    }
}

/// The files, and those in the folders: PNG and PGM, in the order of the numbers in their names.
fn files(paths: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let mut inside = Vec::new();
        for entry in std::fs::read_dir(path).map_err(Failure::file(path))? {
            let file = entry.map_err(Failure::file(path))?.path();
            let extension = file.extension().unwrap_or_default().to_ascii_lowercase();
            if extension == "png" || extension == "pgm" {
                inside.push(file);
            }
        }
        if inside.is_empty() {
            return Err(Failure::Usage(format!("--from {}: there is no PNG or PGM picture", path.display())));
        }
        inside.sort_by_key(|file| order(file));
        files.extend(inside);
    }
    Ok(files)
}

/// What a name is sorted by: 9 comes before 10.
fn order(path: &Path) -> (Vec<(String, u64)>, String) {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut parts = Vec::new();
    let mut rest = name.as_str();
    while let Some(begin) = rest.find(|c: char| c.is_ascii_digit()) {
        let (text, number) = rest.split_at(begin);
        let end = number.find(|c: char| !c.is_ascii_digit()).unwrap_or(number.len());
        parts.push((text.to_owned(), number[..end].parse().unwrap_or(u64::MAX)));
        rest = &number[end..];
    }
    (parts, name)
}

/// The next picture of a stream of binary PGM; when its first byte came; its age, if a comment `# age
/// SECONDS` tells it. `None` at the end.
fn read_pgm(input: &mut impl BufRead) -> io::Result<Option<(Picture, Instant, Option<Duration>)>> {
    let wrong = |text: String| io::Error::new(io::ErrorKind::InvalidData, text);
    let mut header = Vec::new();
    let (mut words, mut age) = (Vec::<String>::new(), None);
    let mut begun = None;
    // The magic number, width, height, maximum; comments end with their lines.
    while words.len() < 4 {
        let start = header.len();
        let mut byte = [0];
        let in_comment = |header: &[u8]| header.get(start) == Some(&b'#');
        loop {
            if input.read(&mut byte)? == 0 {
                let text =
                    format!("the stream ends within the header of a picture, after {} bytes", header.len());
                return if header.is_empty() { Ok(None) } else { Err(wrong(text)) };
            }
            begun.get_or_insert_with(Instant::now);
            // Pictures may be separated by white space.
            if header.len() == start && byte[0].is_ascii_whitespace() {
                continue;
            }
            header.push(byte[0]);
            if header.len() > MAX_HEADER || (header.len() == 2 && header != b"P5") {
                return Err(wrong(format!(
                    "{:?} is not the beginning of a binary PGM picture: P5, width, height, 255",
                    String::from_utf8_lossy(&header[..header.len().min(16)])
                )));
            }
            if byte[0] == b'\n' || (byte[0].is_ascii_whitespace() && !in_comment(&header)) {
                break;
            }
        }
        let text = String::from_utf8_lossy(&header[start..]).trim().to_owned();
        match text.strip_prefix('#') {
            Some(comment) => {
                if let Some(seconds) = comment.trim().strip_prefix("age ") {
                    let seconds =
                        seconds.trim().parse().ok().and_then(|s| Duration::try_from_secs_f64(s).ok());
                    age = Some(seconds.ok_or_else(|| wrong(format!("{text:?}: expected # age SECONDS")))?);
                }
            }
            None => words.push(text),
        }
    }
    let number = |index: usize| {
        words[index].parse::<usize>().map_err(|_| wrong(format!("PGM: {:?} is not a number", words[index])))
    };
    let (width, height, largest) = (number(1)?, number(2)?, number(3)?);
    let picture = Picture::from_pgm(width, height, largest, |count| {
        let mut pixels = Vec::new();
        input.by_ref().take(count as u64).read_to_end(&mut pixels).map_err(|error| error.to_string())?;
        Ok(pixels)
    });
    let begun = begun.unwrap_or_else(Instant::now);
    Ok(Some((picture.map_err(wrong)?, begun, age)))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_stream_is_read_picture_by_picture_with_their_ages() {
        let mut stream =
            b"P5\n# age 0.25\n2 2\n255\n\x00\x0a\x20\xffP5 3 1 255 abc\nP5\n1 1\n# a lens\n255\n#".as_slice();
        let (first, _, age) = read_pgm(&mut stream).unwrap().unwrap();
        assert_eq!((first.width, first.height, first.pixels), (2, 2, vec![0, 10, 32, 255]));
        assert_eq!(age, Some(Duration::from_millis(250)));
        let (second, _, age) = read_pgm(&mut stream).unwrap().unwrap();
        assert_eq!((second.width, second.pixels, age), (3, b"abc".to_vec(), None));
        let (third, ..) = read_pgm(&mut stream).unwrap().unwrap();
        assert_eq!(third.pixels, b"#");
        assert!(read_pgm(&mut stream).unwrap().is_none());
    }

    #[test]
    fn what_is_no_picture_is_named() {
        for (stream, words) in [
            (&b"\x89PNG\r\n"[..], "not the beginning of a binary PGM"),
            (b"P5 2 x 255 ", "\"x\" is not a number"),
            (b"P5 2 2 65535 ", "maximum 65535"),
            (b"P5 2 2 255 abc", "3 of 4 grey levels"),
            (b"P5 2 2", "ends within the header"),
            (b"P5\n# age soon\n2 2 255 abcd", "age SECONDS"),
            (b"P5 99999999 99999999 255 abcd", "268 million"),
        ] {
            let error = read_pgm(&mut &*stream).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }

    #[test]
    fn numbered_files_come_in_the_order_of_their_numbers() {
        let mut names = ["knob-10.png", "knob-9.png", "knob-9b.png", "a.pgm"].map(PathBuf::from).to_vec();
        names.sort_by_key(|name| order(name));
        assert_eq!(names, ["a.pgm", "knob-9.png", "knob-9b.png", "knob-10.png"].map(PathBuf::from));
    }
}
