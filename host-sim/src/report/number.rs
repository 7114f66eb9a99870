//! Formatting of numbers for people.

/// Formats `value` with the given number of significant digits; a whole number in full.
pub(super) fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return if value.is_nan() { "NaN".into() } else { minus(&format!("{value}")) };
    }
    let magnitude = value.abs();
    if magnitude < 1e9 && value.fract() == 0.0 {
        return minus(&format!("{value:.0}"));
    }
    // Uses the exponent after rounding, so that 9.999 becomes 10.0 and not 10.00.
    let scientific = format!("{magnitude:.*e}", digits - 1);
    let exponent: i32 = scientific.split_once('e').and_then(|(_, e)| e.parse().ok()).unwrap_or(0);
    if !(-4..9).contains(&exponent) {
        return minus(&format!("{value:.*e}", digits - 1));
    }
    let decimals = usize::try_from(i32::try_from(digits).unwrap_or(3) - 1 - exponent).unwrap_or(0);
    minus(&format!("{value:.decimals$}"))
}

/// Formats a measured value beside its limit: three digits, or more if three would hide on which side of the
/// limit it is.
pub(super) fn measured(value: f64, limit: Option<f64>) -> String {
    let hidden = |text: &str| {
        let shown = text.replace('−', "-").parse::<f64>().unwrap_or(value);
        limit.is_some_and(|limit| shown.abs().total_cmp(&limit) != value.abs().total_cmp(&limit))
    };
    (3..12)
        .map(|digits| significant(value, digits))
        .find(|text| !hidden(text))
        .unwrap_or_else(|| format!("{value:?}"))
}

/// Formats a limit exactly as it was given.
pub(super) fn exact(value: f64) -> String {
    minus(&format!("{value}"))
}

/// Appends the unit to `text`, if there is one.
pub(super) fn with_unit(text: &str, unit: &str) -> String {
    match unit {
        "" => text.to_owned(),
        "%" | "°" => format!("{text}{}{unit}", if unit == "%" { " " } else { "" }),
        _ => format!("{text} {unit}"),
    }
}

fn minus(text: &str) -> String {
    let text = text.replace('-', "−");
    // A value that rounds to 0 has no sign.
    if text.strip_prefix('−').is_some_and(|rest| rest.bytes().all(|b| matches!(b, b'0' | b'.'))) {
        text.replacen('−', "", 1)
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_digits_whatever_the_size() {
        for (value, text) in [
            (8.314_159, "8.31"),
            (9.999, "10.0"),
            (1234.6, "1235"),
            (0.012_345, "0.0123"),
            (-0.5, "−0.500"),
            (20.0, "20"),
            (3.2e-7, "3.20e−7"),
            (f64::NAN, "NaN"),
            (f64::NEG_INFINITY, "−inf"),
        ] {
            assert_eq!(significant(value, 3), text);
        }
    }

    #[test]
    fn the_side_of_the_limit_shows() {
        assert_eq!(measured(12.004, Some(12.0)), "12.004");
        assert_eq!(measured(11.998, Some(12.0)), "11.998");
        assert_eq!(measured(12.04, Some(12.03)), "12.04");
        assert_eq!(measured(12.004, Some(5.0)), "12.0");
        assert_eq!(measured(12.0, Some(12.0)), "12");
    }
}
