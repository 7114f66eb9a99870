//! Tuning constants of the task: unit, meaning, and effect of a change.

use crate::TICK;

// Approach and search for the surface.

/// Peak speed of the fingertips in `Approach` and `Open` [m/s]. Faster shortens a grasp and hits obstacles
/// harder.
pub(super) const APPROACH_SPEED: f32 = 0.1;
/// Time beyond that of the fastest minimum-jerk motion of the approach [s]. More slows short approaches down.
pub(super) const APPROACH_EXTRA_TIME: f32 = 0.2;
/// Points at which a path is checked before a motion. With fewer, a joint's speed can exceed its limit
/// between two of them.
pub(super) const PATH_CHECKS: u8 = 32;
/// Time for the fingertips to come to rest at the end of a path [s]. If it is too short, the search for the
/// surface begins with vibrating force sensors.
pub(super) const REST_TIME: f32 = 0.3;
/// Speed of a fingertip that searches for the surface [m/s]. Faster makes the impact harder.
pub(super) const TOUCH_SPEED: f32 = 0.02;
/// Consecutive ticks above the touch force that count as contact. More rejects noise and delays the stop.
pub(super) const TOUCH_TICKS: u8 = 2;
/// Force on a fingertip that stops the approach, as a multiple of the touch force. Smaller stops earlier, but
/// also at inertial forces of the tip.
pub(super) const OBSTACLE_FACTOR: f32 = 3.0;

// Phases with an object.

/// Time in which the internal forces rise in `Squeeze` [s]. Less excites the joints' stick-slip.
pub(super) const SQUEEZE_TIME: f32 = 0.5;
/// Time in which the internal forces fall in `Open` [s]. Less releases the contacts less evenly.
pub(super) const OPEN_TIME: f32 = 0.3;
/// Consecutive ticks with converged internal forces that end `Squeeze`. More rejects noise and takes longer.
pub(super) const CONVERGED_TICKS: u8 = 10;
/// Duration of `Squeeze` that counts as failure [s]. Less refuses grips that converge slowly.
pub(super) const SQUEEZE_TIMEOUT: f32 = 3.0;
/// Height above the pose at the grasp from which the object counts as lifted [m]: no support carries it. If
/// it is smaller than the tracker's error, an object on its support counts as lifted.
pub(super) const LIFT_HEIGHT: f32 = 0.002;
/// Mean speed at which the object is lowered [m/s]. Faster sets it down harder.
pub(super) const LOWER_SPEED: f32 = 0.01;
/// Distance of lowering without a support that counts as failure [m]. More finds supports farther below.
pub(super) const MAX_LOWERING: f32 = 0.05;
/// The object stands on a support when its weight on the fingers is below this fraction of that before.
/// Smaller presses it onto the support.
pub(super) const SUPPORTED_FRACTION: f32 = 0.5;
/// Consecutive ticks with that weight. More rejects noise, which could be as large as a light object's
/// weight, and presses longer onto the support.
pub(super) const SUPPORTED_TICKS: u8 = 5;
/// Time at the start of `Lower` in which the weight is not evaluated [s]. Less mistakes inertial forces for a
/// support.
pub(super) const LOWER_START_TIME: f32 = 0.3;
/// Rest in `Hold` before the hand yields to the support of an object [s]. Less mistakes the forces in which a
/// motion has ended for lasting ones.
pub(super) const YIELD_DELAY: f32 = 3.0;
/// Speed with which the hand yields to the support of an object at rest, over the force that presses the
/// object onto it [m/(N·s)]. Larger yields faster, and may lift the object.
pub(super) const YIELD_RATE: f32 = 1e-4;
/// Contact is lost when a normal force is below this fraction of the touch force, for [`CONTACT_LOSS_TICKS`].
/// Larger makes weak grips a fault.
pub(super) const CONTACT_LOSS_FRACTION: f32 = 0.15;
/// Consecutive ticks without contact that count as loss of the object. More rejects noise, and reacts later.
pub(super) const CONTACT_LOSS_TICKS: u8 = 10;
/// Change of a side of the fingertips' triangle beyond which the object slid or rotated between the fingers
/// [m]. Smaller detects a slip earlier; rolling tips must stay below it.
pub(super) const MAX_DEFORMATION: f32 = 0.012;
/// Distance of the object from its target beyond which an external force has moved it [m]. Smaller tolerates
/// weaker pushes.
pub(super) const MAX_DISPLACEMENT: f32 = 0.015;

// Motion of the object.

/// Maximum peak speed of the object [m/s], and maximum peak angular speed [rad/s]. Faster motions are
/// refused; larger limits let inertial forces load the grip more.
pub(super) const MAX_SPEED: f32 = 0.2;
/// See [`MAX_SPEED`].
pub(super) const MAX_ANGULAR_SPEED: f32 = 2.0;
/// Longest motion of the object [s]: during it the object cannot be put down.
pub(super) const MAX_MOVE_TIME: f32 = 600.0;
/// Fraction of the joints' torque limits that forces on the object may take. The rest is for gravity,
/// friction and motion.
pub(super) const TORQUE_FRACTION: f32 = 0.9;
/// Change of a joint's target in a tick beyond which it belongs to another posture [rad]. Larger lets a
/// finger fold over; smaller ends fast motions.
pub(super) const MAX_TARGET_STEP: f32 = 0.2;
/// Bound of the integral part of (Hand3 eq. 19) against wind-up: force [N] and moment [N·m].
pub(super) const MAX_INTEGRAL_FORCE: f32 = 10.0;
/// See [`MAX_INTEGRAL_FORCE`].
pub(super) const MAX_INTEGRAL_MOMENT: f32 = 1.0;

// Tracking of the object.

/// Leakage of the anchors towards the measured fingertips, per tick. Larger forgets a slip sooner and so
/// hides it.
pub(super) const ANCHOR_LEAKAGE: f32 = 0.1;
/// Gain of the first-order filter of the fingertips in the object frame, per tick. If it is too small,
/// position control works against the internal forces; if too large, it does not hold back a finger that
/// loses contact.
pub(super) const CENTER_FILTER_GAIN: f32 = 0.4;

// Load.

/// Gain of the first-order filter of the load, per tick. Larger follows faster and passes more noise.
pub(super) const LOAD_FILTER_GAIN: f32 = 0.5;
/// Gain of the filter of the earlier load, with which the present one is compared, per tick: a time constant
/// of some 80 ms. Smaller detects slower growth of the load.
pub(super) const EARLIER_LOAD_FILTER_GAIN: f32 = 0.12;
/// Gain of the filter of the object's weight, per tick: a time constant of some 0.5 s. Larger mistakes pushes
/// for weight.
pub(super) const WEIGHT_FILTER_GAIN: f32 = 0.02;
/// Bounds of that weight on each axis: force [N] and moment [N·m]. Larger permits heavier objects under
/// wrench control, and presses harder on what holds an object back.
pub(super) const MAX_WEIGHT_FORCE: f32 = 10.0;
/// See [`MAX_WEIGHT_FORCE`].
pub(super) const MAX_WEIGHT_MOMENT: f32 = 1.0;
/// Fraction of the load that is fed forward once no support carries the object; it rises between one and two
/// times [`LIFT_HEIGHT`]. Larger makes the servos faster. With 1, joints with larger torque constants than in
/// the model would lift a heavy object: the sensors measure the excess as load, which is positive feedback.
pub(super) const LOAD_FEEDFORWARD: f32 = 0.9;
/// Growth of the load that exceeds sensor noise [N]. Smaller lets noise tighten the grip.
pub(super) const LOAD_GROWTH_THRESHOLD: f32 = 0.09;
/// Anticipated further increase of a growing load over its growth within the filter's time. Larger prevents
/// more slips and grips harder.
pub(super) const ANTICIPATION_GAIN: f32 = 1.3;
/// Time constant with which the anticipated increase decays [s]. Longer keeps the firmer grip longer.
pub(super) const ANTICIPATION_DECAY_TIME: f32 = 0.25;

/// Largest mass of an object whose weight is not measured [kg]. Larger accepts weights that no finger can
/// carry.
pub(super) const MAX_MASS: f32 = 5.0;

// Grip.

/// Additional minimum normal force for each newton of anticipated load. The joints' dry friction absorbs the
/// first part of a rising force.
pub(super) const PRELOAD_GAIN: f32 = 4.0;
/// Maximum of that additional force [N]. Larger protects against faster loads and may crush soft objects.
pub(super) const MAX_PRELOAD: f32 = 0.5;
/// Tolerance of the least grip: residual over load. The load is not measured more accurately. Smaller needs
/// more Newton steps.
pub(super) const GRIP_TOLERANCE: f32 = 0.02;
/// Budget of a tick for the least grip [instructions]; one Newton step is taken in any case. More finishes
/// searches in fewer ticks.
pub(super) const GRIP_BUDGET: u32 = 9_000;
/// Time constant with which an excess of grip decays [s]. Less releases the grip before the forces are exact
/// again.
pub(super) const GRIP_RELEASE_TIME: f32 = 0.3;
/// Largest residual wrench of forces along the normals, over the forces. Larger accepts contacts that oppose
/// each other less exactly.
pub(super) const NORMAL_TOLERANCE: f32 = 0.1;

// Force feedback.

/// Integral gain of the internal forces [1/s]. Larger converges faster, up to a limit cycle of the joints'
/// friction.
pub(super) const FORCE_INTEGRAL_GAIN: f32 = 30.0;
/// Bound of the integral part, on each axis, against wind-up [N]. Larger corrects larger errors of the
/// torques, and overshoots more after an error that lasts.
pub(super) const MAX_FORCE_CORRECTION: f32 = 5.0;
/// Dead band of the least grip: measured normal forces may exceed the target by this fraction and this force
/// [N]. Without it, integral action and dry friction make a limit cycle, and contacts slide in its minima.
pub(super) const DEAD_BAND_FRACTION: f32 = 0.1;
/// See [`DEAD_BAND_FRACTION`].
pub(super) const DEAD_BAND_FORCE: f32 = 0.05;
/// Internal forces have converged when their error along the normal is below this fraction of the target plus
/// [`CONVERGED_FORCE`] [N].
pub(super) const CONVERGED_FRACTION: f32 = 0.1;
/// See [`CONVERGED_FRACTION`].
pub(super) const CONVERGED_FORCE: f32 = 0.1;

// Torque gains of the joints.

/// Rate at which the gains are learnt, per tick. Larger follows faster and learns friction.
pub(super) const GAIN_LEARNING_RATE: f32 = 0.03;
/// Torque with which a gain is learnt at half of that rate [N·m]. Larger leaves gains of weak grips as they
/// are.
pub(super) const GAIN_TORQUE: f32 = 0.2;
/// What the friction may be, over that of the model. Smaller mistakes friction for a gain.
pub(super) const GAIN_FRICTION: f32 = 1.2;
/// Bounds of a gain. Wider corrects worse torque constants, and trusts sensors more.
pub(super) const MIN_GAIN: f32 = 0.7;
/// See [`MIN_GAIN`].
pub(super) const MAX_GAIN: f32 = 1.3;

// Friction and slip.

/// Coefficient of friction where none was given or probed. Smaller grips harder.
pub const ASSUMED_FRICTION: f32 = 0.4;
/// Lower bound of the estimated coefficient of friction. Smaller allows harder grips after slips.
pub(super) const MIN_FRICTION: f32 = 0.15;
/// Upper bound of the probed coefficient of friction; probing ends there. Larger allows lighter grips.
pub(super) const MAX_FRICTION: f32 = 1.0;
/// Normal forces below this do not determine the friction [N]. Smaller mistakes noise for slip.
pub(super) const MIN_NORMAL_FORCE: f32 = 0.1;
/// Gain of the first-order filters of a contact's tangential force, over the normal force and beyond the
/// limit of incipient slip, per tick. Larger detects slip earlier, and passes more noise.
pub(super) const CONTACT_FILTER_GAIN: f32 = 0.5;
/// Slip is incipient when the tangential force of a contact, filtered, exceeds this fraction of the friction
/// limit, and [`FORCE_NOISE`] more. Smaller tightens the grip earlier.
pub(super) const INCIPIENT_SLIP_FRACTION: f32 = 0.97;
/// Noise of the force sensors [N]. Smaller mistakes noise for incipient slip.
pub(super) const FORCE_NOISE: f32 = 0.05;
/// Growing distance of a fingertip from its anchor that counts as slip [m], if its force ratio is above
/// [`SLIP_MIN_FRACTION`] of the friction.
pub(super) const SLIP_DISTANCE: f32 = 6e-5;
/// See [`SLIP_DISTANCE`].
pub(super) const SLIP_MIN_FRACTION: f32 = 0.75;
/// After a slip the friction estimate is this fraction of the force ratio measured then. Smaller grips
/// harder.
pub(super) const FRICTION_AFTER_SLIP: f32 = 0.92;
/// One slip lowers the friction estimate at most to this fraction. Smaller adapts in fewer slips.
pub(super) const MIN_FRICTION_STEP: f32 = 0.85;
/// Increase of the internal forces in each tick with a slip, as a fraction. Larger stops a slip earlier.
pub(super) const SLIP_GRIP_STEP: f32 = 0.5;
/// Maximum of that increase, as a fraction. Larger may crush soft objects.
pub(super) const MAX_SLIP_GRIP: f32 = 2.0;
/// Time constant with which that increase decays [s]. Shorter lets the contact slide again.
pub(super) const SLIP_GRIP_DECAY_TIME: f32 = 0.4;
/// Rate of the probe force while it rises [N/s]. Faster overshoots the friction limit.
pub(super) const PROBE_RATE: f32 = 0.5;
/// Rate of the probe force while it falls [N/s]. Faster ends the phase earlier, with a larger step of the
/// force.
pub(super) const PROBE_RELEASE_RATE: f32 = 2.0;
/// Decrease of the distance between fingers 1 and 2 that counts as slip [m]. Smaller mistakes elastic motion
/// for slip, larger slides farther.
pub(super) const PROBE_SLIP_DISTANCE: f32 = 6e-5;
/// Fraction of the probe force that stays when a finger slides. Smaller stops the slip earlier.
pub(super) const PROBE_STOP_FRACTION: f32 = 0.5;
/// Duration of the rise of the probe force after which [`ASSUMED_FRICTION`] is used [s]. Longer probes firmer
/// grips.
pub(super) const PROBE_TIMEOUT: f32 = 5.0;

// Dither.

/// Amplitude of the normal dither at its start, as a fraction of the internal forces. It must exceed the
/// joints' dry friction. Larger comes nearer to the force limit.
pub(super) const NORMAL_DITHER: f32 = 0.5;
/// Amplitude of the tangential dither at its start, as a fraction of the smallest internal force. Larger
/// reaches more friction, and comes nearer to slip.
pub(super) const TANGENTIAL_DITHER: f32 = 0.2;
/// Duration of each of the two dithers [s]. Longer leaves less hysteresis.
pub(super) const DITHER_TIME: f32 = 1.1;
/// Ticks of `Squeeze` until the dither begins, and until it has ended.
pub(super) const TICKS_TO_DITHER: u32 = ticks(SQUEEZE_TIME);
/// See [`TICKS_TO_DITHER`].
pub(super) const TICKS_TO_DITHER_END: u32 = ticks(SQUEEZE_TIME + 2.0 * DITHER_TIME);
/// Period of the normal dither [s]. Shorter is filtered by the motors, longer moves the joints.
pub(super) const NORMAL_DITHER_PERIOD: f32 = 0.06;
/// Periods of the two directions of the tangential dither [s]; different, so that their peaks do not
/// coincide.
pub(super) const TANGENTIAL_DITHER_PERIODS: [f32; 2] = [0.06, 0.08];
/// Fraction of the friction limit that internal forces with tangential dither may take. Larger risks slip.
pub(super) const DITHER_FRICTION_FRACTION: f32 = 0.8;

/// Converts a time [s] to ticks.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive, and a few hundred")]
const fn ticks(time: f32) -> u32 {
    (time / TICK + 0.5) as u32
}
