//! The lines between vision (`tesaki look`, or a program of the user) and behaviour (`tesaki approach`).

use serde::{Deserialize, Deserializer, Serialize};
use tesaki::vision::{Circle, CircleSearch, Window};

use crate::find_circle::Known;

/// The version of these lines.
const VERSION: u32 = 1;
/// Oldest picture [s].
pub const MAX_AGE: f64 = 1.0;
/// Smallest radius or semi-axis of a circle that can be seen [px].
const SMALLEST: f32 = 1.0;
/// Largest coordinate [px].
const FARTHEST: f32 = 1e5;

/// From vision: what is in a picture, or, without `circle`, the question what to look for in it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sight {
    /// Of these lines; may be left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<u32>,
    /// Number of the picture: the answer has it too.
    pub picture: u64,
    /// Time since the middle of its exposure [s].
    pub age: f64,
    /// Width and height of the picture [px].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<[usize; 2]>,
    /// `null` where none was found.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "present")]
    pub circle: Option<Option<SeenCircle>>,
}

/// Tells `null` from a missing key.
fn present<'de, D: Deserializer<'de>>(value: D) -> Result<Option<Option<SeenCircle>>, D::Error> {
    Option::deserialize(value).map(Some)
}

/// A circle as [`Circle`], of which others than tesaki's own finder may give less.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeenCircle {
    pub center: [f32; 2],
    pub radius: f32,
    /// Without them a true circle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub semi_axes: Option<[f32; 2]>,
    #[serde(default)]
    pub angle: f32,
    /// Probability that it is the rose.
    #[serde(default = "certain")]
    pub confidence: f32,
}

const fn certain() -> f32 {
    1.0
}

impl From<Circle> for SeenCircle {
    fn from(circle: Circle) -> Self {
        let Circle { center, radius, semi_axes, angle, confidence } = circle;
        Self { center, radius, semi_axes: Some(semi_axes), angle, confidence }
    }
}

impl From<SeenCircle> for Circle {
    fn from(seen: SeenCircle) -> Self {
        let SeenCircle { center, radius, semi_axes, angle, confidence } = seen;
        Self { center, radius, semi_axes: semi_axes.unwrap_or([radius; 2]), angle, confidence }
    }
}

impl Sight {
    /// The content of a line, for pictures of `size` if that is known.
    pub fn read(line: &str, size: Option<[usize; 2]>) -> Result<Self, String> {
        let sight: Self = serde_json::from_str(line).map_err(|error| error.to_string())?;
        let Self { version, age, size: found, .. } = sight;
        if let Some(version) = version.filter(|version| *version != VERSION) {
            return Err(format!("lines of version {version}; this program reads version {VERSION}"));
        }
        if !(0.0..=MAX_AGE).contains(&age) {
            return Err(format!(
                "age {age} s; it must be 0 to {MAX_AGE} s: the time since the middle of the exposure"
            ));
        }
        if let (Some(expected), Some(found)) = (size, found)
            && expected != found
        {
            let ([width, height], [w, h]) = (found, expected);
            return Err(format!(
                "a picture of {width} × {height} pixels; the camera was calibrated with {w} × {h} (hand_eye.toml): scale the \
                 pictures, or calibrate the camera with this size"
            ));
        }
        if let Some(Some(circle)) = sight.circle {
            circle.check()?;
        }
        Ok(sight)
    }
}

impl SeenCircle {
    fn check(&self) -> Result<(), String> {
        let Self { center, radius, semi_axes, angle, confidence } = *self;
        let lengths = [radius].into_iter().chain(semi_axes.into_iter().flatten());
        if let Some(bad) = { lengths }.find(|length| !(*length >= SMALLEST && *length < FARTHEST)) {
            return Err(format!(
                "a radius or semi-axis of {bad} px; it must be at least {SMALLEST} px and below {FARTHEST} px"
            ));
        }
        // Nor what is no number.
        if !center.iter().all(|value| value.abs() < FARTHEST) || !angle.is_finite() {
            return Err(format!(
                "center {center:?} px, angle {angle} rad; below {FARTHEST} px and finite are expected"
            ));
        }
        if !(0.0..=1.0).contains(&confidence) {
            return Err(format!("confidence {confidence}; it must be 0 to 1"));
        }
        Ok(())
    }
}

/// From behaviour to vision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Answer {
    /// At the beginning.
    Greeting { version: u32 },
    /// What to look for in a picture; `null`: nothing, it is not needed.
    Search { picture: u64, search: Option<Search> },
    /// What is wrong with a line.
    Error { error: String },
}

impl Answer {
    /// For who has connected.
    pub const GREETING: Self = Self::Greeting { version: VERSION };

    /// The content of a line.
    pub fn read(line: &str) -> Result<Self, String> {
        let answer = serde_json::from_str(line).map_err(|error| error.to_string())?;
        match answer {
            Self::Greeting { version } if version != VERSION => {
                Err(format!("it speaks version {version} of the lines; this program version {VERSION}"))
            }
            answer => Ok(answer),
        }
    }
}

/// A [`CircleSearch`] as JSON: windows are x, y, reach [px].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Search {
    pub radius: [f32; 2],
    pub window: Option<[f32; 3]>,
    pub axis: Option<[f32; 3]>,
}

impl From<CircleSearch> for Search {
    fn from(search: CircleSearch) -> Self {
        let window = |Window { center: [x, y], reach }: Window| [x, y, reach];
        Self { radius: search.radius, window: search.window.map(window), axis: search.axis.map(window) }
    }
}

impl From<Search> for Known {
    fn from(Search { radius, window, axis }: Search) -> Self {
        Self { radius: Some(radius), window, axis }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_line_asks_or_tells_and_null_is_no_circle() {
        let read = |line: &str| Sight::read(line, Some([256, 240])).unwrap();
        assert_eq!(read("{\"picture\": 7, \"age\": 0.03}").circle, None);
        assert_eq!(read("{\"picture\": 7, \"age\": 0.03, \"circle\": null}").circle, Some(None));
        let told = read(
            "{\"version\": 1, \"picture\": 7, \"age\": 0, \"size\": [256, 240], \
             \"circle\": {\"center\": [1, 2], \"radius\": 3}}",
        );
        let circle = Circle::from(told.circle.unwrap().unwrap());
        assert_eq!((circle.center, circle.radius), ([1.0, 2.0], 3.0));
        assert_eq!((circle.semi_axes, circle.confidence), ([3.0, 3.0], 1.0));
    }

    #[test]
    fn what_is_no_sight_is_named() {
        let circle = |content: &str| format!("{{\"picture\": 1, \"age\": 0.1, \"circle\": {{{content}}}}}");
        for (line, words) in [
            ("nonsense".to_owned(), "expected"),
            ("{\"picture\": 1}".to_owned(), "age"),
            ("{\"picture\": 1, \"age\": 3.0}".to_owned(), "age 3 s; it must be 0 to 1 s"),
            ("{\"picture\": 1, \"age\": 0, \"cirle\": null}".to_owned(), "cirle"),
            ("{\"version\": 2, \"picture\": 1, \"age\": 0}".to_owned(), "version 2"),
            ("{\"picture\": 1, \"age\": 0, \"size\": [640, 480]}".to_owned(), "calibrated with 256 × 240"),
            (circle("\"center\": [1, 2], \"radius\": 0.5"), "at least 1 px"),
            (circle("\"center\": [1e30, 2], \"radius\": 9"), "center"),
            (circle("\"center\": [1, 2], \"radius\": 9, \"confidence\": 2"), "confidence 2"),
            (circle("\"center\": [1], \"radius\": 9"), "length"),
        ] {
            let error = Sight::read(&line, Some([256, 240])).unwrap_err();
            assert!(error.contains(words), "{line}: {error}");
        }
    }

    #[test]
    fn answers_come_back_as_they_were_sent() {
        let search = Search { radius: [9.5, 30.0], window: None, axis: Some([127.0, 95.0, 9.8]) };
        for answer in [
            Answer::GREETING,
            Answer::Search { picture: 3, search: Some(search) },
            Answer::Search { picture: 4, search: None },
            Answer::Error { error: "why".to_owned() },
        ] {
            let line = serde_json::to_string(&answer).unwrap();
            assert_eq!(Answer::read(&line), Ok(answer), "{line}");
        }
        assert!(Answer::read("{\"version\": 9}").unwrap_err().contains("version 9"));
    }
}
