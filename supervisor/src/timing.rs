//! Times that all programs which drive a board keep to.

use std::time::Duration;

/// Period of what is sent to an enabled board: well below its command timeout, so that a few may be lost.
pub const KEEP_ALIVE: Duration = Duration::from_millis(20);
/// Maximum age at which telemetry still shows where the joints are.
pub const FRESH: Duration = Duration::from_millis(200);
/// For this time after an answer of the board, telemetry from before may still arrive.
pub const LATE: Duration = Duration::from_millis(200);
/// Without telemetry for this time, nothing more is commanded.
pub const BLIND: Duration = Duration::from_millis(500);
/// Without telemetry for this time, a program that only watches requests its streams again.
pub const SILENCE: Duration = Duration::from_millis(700);
/// How long a board is told to stop before it is said that it does not show it. It is told so on.
pub const STOP_PATIENCE: Duration = Duration::from_secs(2);
/// How long a board that may be gone is told to disable.
pub const LAST_WORD: Duration = Duration::from_millis(500);
