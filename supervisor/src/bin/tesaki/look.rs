//! `look`: the vision of a visual approach. Finds the rose of a door knob in pictures, for `tesaki approach`.

mod behavior;
mod pictures;
#[cfg(target_os = "linux")]
mod v4l2;

use std::sync::atomic::Ordering;
use std::time::Duration;

use tesaki::vision::Circle;

use crate::args::{Look, Options};
use crate::board_session::interrupted;
use crate::failure::Failure;
use crate::find_circle::{self, Known, search};
use crate::output;
use crate::sight::{MAX_AGE, Sight};
use behavior::Behavior;
use pictures::{Pictures, Taken};

/// How long a picture is waited for before Ctrl-C is looked for.
const WAIT: Duration = Duration::from_millis(50);

pub fn run(options: &Options, args: &Look) -> Result<(), Failure> {
    let interrupted = interrupted()?;
    let pictures = Pictures::open(args)?;
    let mut eye = Eye {
        options,
        known: Known { radius: args.radius, window: None, axis: args.axis },
        behavior: args.to.clone().map(Behavior::new),
        live: output::Live::new(options),
        trouble: None,
        looked: 0,
        found: 0,
        old: 0,
    };
    let ending = loop {
        if interrupted.load(Ordering::Relaxed) {
            break Ok(());
        }
        if let Some(trouble) = pictures.trouble() {
            eye.complain(trouble);
        }
        if let Some(taken) = pictures.next(WAIT) {
            eye.look(&taken)?;
        } else if let Some(ending) = pictures.ending() {
            break ending;
        }
    };
    eye.live.end();
    if eye.behavior.is_some() {
        let (looked, found, skipped) = (eye.looked, eye.found, pictures.skipped() + eye.old);
        let value = serde_json::json!({ "pictures": looked, "found": found, "skipped": skipped });
        output::result(options, &value, || {
            format!(
                "done: {} looked at, a circle in {found}, {skipped} skipped",
                output::counted(looked, "picture")
            )
        })?;
    }
    ending.map_err(Failure::Other)
}

/// What looks at pictures one after the other.
struct Eye<'a> {
    options: &'a Options,
    /// What is known without the behaviour.
    known: Known,
    behavior: Option<Behavior>,
    live: output::Live,
    /// What was complained of last.
    trouble: Option<String>,
    looked: usize,
    found: usize,
    /// Pictures that were too old for the behaviour.
    old: u64,
}

impl Eye<'_> {
    /// Says what is wrong, once.
    fn complain(&mut self, trouble: String) {
        if self.trouble.as_ref() != Some(&trouble) {
            self.live.end();
            output::notice(self.options, &trouble);
            self.trouble = Some(trouble);
        }
    }

    /// Whether a picture is too old for the behaviour, which would call the line bad: the camera was stopped,
    /// or this program.
    fn is_old(&mut self, sight: &Sight) -> bool {
        let is_old = self.behavior.is_some() && sight.age > MAX_AGE;
        if is_old {
            self.old += 1;
            self.complain(format!("pictures older than {MAX_AGE} s are skipped: do camera and PC keep up?"));
        }
        is_old
    }

    fn look(&mut self, taken: &Taken) -> Result<(), Failure> {
        let number = self.looked as u64;
        let size = [taken.picture.width, taken.picture.height];
        let sight = |circle: Option<Option<Circle>>| Sight {
            version: None,
            picture: number,
            age: taken.exposed.elapsed().as_secs_f64(),
            size: Some(size),
            circle: circle.map(|circle| circle.map(Into::into)),
        };
        let question = sight(None);
        if self.is_old(&question) {
            return Ok(());
        }
        self.looked += 1;
        let known = match &mut self.behavior {
            Some(behavior) => behavior.ask(&question, &self.known),
            None => Some(self.known),
        };
        let Some(known) = known else { return Ok(()) };
        // A knob that is expected outside of the picture, or too small or large, is not looked for.
        let known = match self.behavior {
            Some(_) => known.within(size).filter(|known| !is_outside(known, size)),
            None => Some(known),
        };
        let searched = known.map_or(Ok((None, 0.0)), |known| search(&taken.name, &taken.picture, &known));
        let (circle, milliseconds) = match searched {
            // Another picture may be better; the behaviour gives up when none is.
            Err(failure) if self.behavior.is_some() => {
                self.complain(failure.to_string());
                (None, 0.0)
            }
            searched => searched?,
        };
        self.found += usize::from(circle.is_some());
        let answer = sight(Some(circle));
        if self.is_old(&answer) {
            return Ok(());
        }
        let Some(behavior) = &mut self.behavior else {
            return if self.options.json {
                output::line(&find_circle::object(&taken.name, circle.as_ref(), milliseconds).to_string())
            } else {
                output::line(&find_circle::line(&taken.name, circle.as_ref(), milliseconds))
            };
        };
        behavior.tell(&answer);
        let troubles: Vec<String> = behavior.troubles.drain(..).collect();
        let is_heard = behavior.is_connected();
        troubles.into_iter().for_each(|trouble| self.complain(trouble));
        if is_heard {
            self.trouble = None;
            self.live.show(&find_circle::line(&taken.name, circle.as_ref(), milliseconds));
        }
        Ok(())
    }
}

#[expect(clippy::cast_precision_loss, reason = "a small number")]
fn is_outside(known: &Known, size: [usize; 2]) -> bool {
    known
        .window
        .is_some_and(|window| (0..2).any(|axis| !(0.0..=(size[axis] - 1) as f32).contains(&window[axis])))
}
