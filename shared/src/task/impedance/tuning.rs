//! Constants of the impedance control: unit, meaning, and effect of a change.

/// Fraction of the remaining difference to a new impedance that is blended in per tick. A larger one changes
/// the impedance faster and steps the torque more.
pub(super) const IMPEDANCE_BLEND: f32 = 0.05;

/// Contact ends when the squared force falls below this fraction of the squared contact force: a hysteresis
/// of two thirds in force. A larger one lets contact detection chatter.
pub(super) const CONTACT_HYSTERESIS_SQUARED: f32 = 4.0 / 9.0;
/// Contact also ends when the squared force falls below this fraction of its last value: a sudden loss of
/// contact. A smaller one detects the loss later, and the tool overshoots.
pub(super) const CONTACT_LOSS_SQUARED: f32 = 0.1;
/// Minimum time between the release of a tool and the first reading that shows it [s]: the averaging window
/// of the simulated sensor; the delay of `board-weact` is longer. On average it is half a period more. A
/// larger value compensates more of that, but gives a tool that was released just before too much velocity.
pub(super) const FREE_BEFORE_READING: f32 = 5e-4;
/// Gain of the disturbance estimate during contact, as a fraction of that in free space. The measured force
/// lags, and a faster estimate mistakes the lag for a disturbance.
pub(super) const CONTACT_DISTURBANCE_GAIN: f32 = 0.15;
/// Fraction of the friction that is compensated during contact. Overcompensation causes a limit cycle against
/// the environment.
pub(super) const CONTACT_FRICTION_COMPENSATION: f32 = 0.7;

/// Dead band of the disturbance estimate at rest [rad]. It prevents the stiction limit cycle (hunting) of
/// integral action with Coulomb friction; a larger one leaves a larger error at rest.
pub(super) const REST_ERROR: f32 = 1e-4;
/// Speed below which a joint of the reference arm is at rest [rad/s].
pub(super) const REST_SPEED: f32 = 2e-3;
/// The same during a contact that the force sensor measures. There the reference is the measured state, whose
/// speed is uncertain by some counts of the encoder. A smaller one lets the force on a stiff wall change by a
/// newton when a joint breaks away late; a larger one leaves a larger error of the force at rest.
pub(super) const CONTACT_REST_SPEED: f32 = 4e-2;
/// The same while the set-points are at rest, too. There the disturbance estimate would integrate against
/// joint friction. A smaller one lets the force hunt longer on a stiff wall; a larger one leaves more of the
/// model error in the tool's position.
pub(super) const PRESSING_REST_SPEED: f32 = 0.12;
/// Speed below which a set-point is at rest [m/s, rad/s].
pub(super) const SETPOINT_REST_SPEED: f32 = 1e-3;

/// Largest distance of an elbow set-point that is wrapped [rad]: beyond it single precision has less than
/// five digits after the point.
pub(super) const MAX_ELBOW_DISTANCE: f32 = 100.0;

/// Tolerance of the norm of a unit quaternion.
pub(super) const NORM_TOLERANCE: f32 = 1e-3;

/// Limit of the elbow error in the elbow's control law [rad]. It bounds the null-space motion where the arm
/// angle changes fast, near a vertical line from shoulder to wrist.
pub(super) const MAX_ELBOW_ERROR: f32 = 0.3;
/// Damping of the null-space motion, as the square of the arm angle's projected gradient. It bounds that
/// motion where the arm angle is not controllable.
pub(super) const ARM_ANGLE_DAMPING: f32 = 1e-4;
/// Distance of the elbow from the line of shoulder and wrist below which the gradient of the arm angle is
/// bounded [m].
pub(super) const MIN_ELBOW_OFFSET: f32 = 0.01;

/// Acceleration of the tool that the disturbance observers may compensate [m/s²]. With a larger one the tool
/// presses harder if its sensor reads nothing; a smaller one mistakes errors of the model, up to 5.2 in the
/// scenarios, for a contact.
pub(super) const MAX_TOOL_DISTURBANCE: f32 = 7.5;
/// Consecutive ticks of such a disturbance that are a fault. With more the arm presses longer; with fewer
/// this fault would precede the detection of a joint that runs away, after three ticks, which switches the
/// outputs off.
pub(super) const MISMATCH_TICKS: u8 = 4;

/// Fraction of a joint's velocity limit that the reference arm uses. The rest is a margin for tracking.
pub(super) const VELOCITY_LIMIT_FRACTION: f32 = 0.6;
/// Speed at which a joint approaches its position limit, per distance from the limit [1/s]. A larger one
/// brakes later and harder.
pub(super) const LIMIT_APPROACH_RATE: f32 = 5.0;

/// Speeds at which the set-point moves to the tool after a fault [m/s, rad/s]. Faster ones release the
/// contact force sooner, but let the tool spring back faster.
pub(super) const RELEASE_SPEED: f32 = 0.1;
pub(super) const RELEASE_ANGULAR_SPEED: f32 = 0.5;

/// Smallest singular value of the Jacobian below which its inverse is damped. Rows in m and rad, unscaled:
/// the arm is about half a metre long. A larger one keeps the joints slower near singular postures and the
/// tool less exact.
pub(super) const DAMPED_BELOW: f32 = 0.06;
/// Damping of the inverse at a singular value of 0.
pub(super) const MAX_DAMPING: f32 = 0.04;
/// Minimum pivot of the factorisation, above rounding errors.
pub(super) const MIN_PIVOT: f32 = 1e-7;
/// Steps of the inverse iteration that find the smallest singular value at the start.
pub(super) const INITIAL_ITERATIONS: usize = 16;

/// Time at rest after which the residual of the estimate of external torques counts as model error
/// [ticks]: 0.4 s. A shorter time tares before its filter has converged.
pub(super) const REST_TICKS: u8 = 40;
/// Minimum bandwidth of the estimate of external torques [rad/s]: a slower one has not converged after
/// [`REST_TICKS`].
pub(super) const MIN_FORCE_BANDWIDTH: f32 = 10.0;
/// Maximum bandwidth of that estimate and of the elbow [rad/s]: half a radian per control period.
pub(super) const MAX_BANDWIDTH: f32 = 50.0;

/// Smallest jump of the force, as a fraction of the recent peak, that counts for derating. With a smaller
/// one, a person who shakes the tool at 4 Hz would cause derating.
pub(super) const MIN_JUMP: f32 = 0.25;
/// Fraction of the peak that remains after a tick.
pub(super) const FORCE_FADE: f32 = 0.98;
/// Longest time between two jumps of one oscillation [ticks]: 0.3 s, the flight time of a bouncing tool.
pub(super) const OSCILLATION_TICKS: u8 = 30;
/// A jump below this fraction of the previous one in the same direction belongs to an oscillation that decays
/// by itself.
pub(super) const UNDAMPED: f32 = 0.8;
/// Jumps of one oscillation before derating begins. With fewer, a tool that bounces once would be derated.
pub(super) const MIN_ALTERNATIONS: u8 = 4;
/// Growth of the derating with each further jump. A larger one ends the oscillation sooner, and makes the
/// tool heavier than necessary.
pub(super) const DERATING_GROWTH: f32 = 1.3;
/// Longest contact that is an impact [ticks]. A person who throws the tool back holds it for longer; in a
/// longer contact the impedance itself moves it.
pub(super) const MAX_IMPACT_TICKS: u8 = 5;
/// Speed of the tool from which on an impact counts [m/s]. With a lower one, errors of the velocity do.
pub(super) const MIN_IMPACT_SPEED: f32 = 0.03;
/// Speed after an impact over that before it to which a rebound faster than its impact is derated. With a
/// lower one the tool becomes heavier than necessary; with a higher one it bounces more often.
pub(super) const DERATED_RESTITUTION: f32 = 0.5;
/// Maximum derating: four times [`MAX_MASS_RATIO`], as the arm's own mass grows as it moves and is larger
/// between the axes.
pub(super) const MAX_DERATING: f32 = 16.0;
/// Ticks after the last jump from which on the derating decays while the tool is free: 1 s.
pub(super) const DERATING_END: u8 = 100;
/// Fraction of the derating that remains after a tick of decay, and the derating that is negligible.
pub(super) const DERATING_FADE: f32 = 0.97;
pub(super) const MIN_DERATING: f32 = 1.01;

/// Largest ratio of the arm's own mass along an axis to the mass of the impedance there. With a larger one a
/// contact with 50 000 N/m would reach 150 N, the force limit of robots/arm7, before derating ends the
/// oscillation.
pub(super) const MAX_MASS_RATIO: f32 = 4.0;
/// Largest own mass along an axis that counts, as a multiple of the mean: at a singular posture it is
/// infinite, and the damped inverse does not move the tool.
pub(super) const MAX_OWN_MASS_RATIO: f32 = 5.0;
/// Factor of the arm's own mass in the condition for a stable contact: errors of the model of 20 %, and the
/// lag of drives and velocity estimate, which the condition neglects.
pub(super) const OWN_MASS_MARGIN: f32 = 1.3;
