//! Calibration files.
#![allow(clippy::unwrap_used, reason = "tests")]

use tesaki_description::calibration::{Calibration, CalibrationFile};

/// A value that TOML cannot have is refused by both readers, not by that of `tesaki identify` alone.
#[test]
fn an_integer_beyond_64_bits_is_refused_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("calibration.toml");
    std::fs::write(&path, "[joints.elbow]\ntorque_constant = 17777777777087777777\n").unwrap();
    for refusal in [Calibration::load(&path).unwrap_err(), CalibrationFile::open(&path).unwrap_err()] {
        let message = refusal.to_string();
        assert!(message.contains("calibration.toml:2: integer number overflowed"), "{message}");
    }
}
