//! Settings of an impedance that the board accepts, and that hardly anyone means: of another unit, or without
//! damping.

use tesaki::math::sqrt;
use tesaki::model::RobotModel;
use tesaki::task::impedance::{ForceSource, ImpedanceSettings};

use crate::robot::chain_length;

/// Factor of the mass of all links beyond which a mass is not meant: the motors would have to push as much
/// against each motion of a person.
const MUCH_MASS: f32 = 10.0;
/// Damping ratio below which the tool swings for more than ten periods until a tenth of a push is left.
const LITTLE_DAMPING: f32 = 0.03;
/// Time constant of the return to the set-point beyond which it seems not to return [s].
const SLOW: f32 = 5.0;
/// Least lever of a motor on a force at the tool, of the length of the arm.
const SHORT_LEVER: f32 = 0.1;

/// A key, what is doubtful, and what to do.
pub type Doubt = (&'static str, String, &'static str);

/// What is doubtful in valid settings for the robot of `model`; of the axes the first.
pub fn of(settings: &ImpedanceSettings, model: &RobotModel) -> Vec<Doubt> {
    let impedance = &settings.impedance;
    let length = chain_length(model, 0);
    let links: f32 = model.joints.iter().map(|joint| joint.link.mass).sum();
    let mut found: Vec<Doubt> = Vec::new();
    let mut add = |doubt: Doubt| {
        if !found.iter().any(|known| known.0 == doubt.0) {
            found.push(doubt);
        }
    };
    for axis in 0..6 {
        let [mass, damping, stiffness] =
            [impedance.mass, impedance.damping, impedance.stiffness].map(|values| values[axis]);
        let place = ["along x", "along y", "along z", "about x", "about y", "about z"][axis];
        let (largest, units, what) = if axis < 3 {
            (MUCH_MASS * links, ["kg", "N·s/m", "N/m"], "ten times the mass of all links")
        } else {
            let largest = links * length * length;
            (largest, ["kg·m²", "N·m·s/rad", "N·m/rad"], "all links at the end of the arm")
        };
        if mass > largest {
            let message = format!("the mass {place} is {mass} {}: {what} would be {largest:.3}", units[0]);
            add(("mass", message, "check the unit: 1000 g are 1 kg, 1e6 kg·mm² are 1 kg·m²"));
        }
        let ratio = damping / (2.0 * sqrt(stiffness * mass));
        // Without spring and damping it is no number.
        if ratio.is_nan() || ratio < LITTLE_DAMPING {
            let effect = if stiffness > 0.0 {
                format!("a damping ratio of {ratio:.3}: after a push the tool swings on and on")
            } else {
                "without spring and damping the tool drifts after a push".to_owned()
            };
            let message = format!("the damping {place} is {damping} {}: {effect}", units[1]);
            let advice = "2 √(stiffness · mass) damps critically, a third of it well; 1 N·s/mm is 1000 N·s/m";
            add(("damping", message, advice));
        }
        let time = (damping / stiffness).max(sqrt(mass / stiffness));
        if stiffness > 0.0 && time > SLOW {
            let message = format!(
                "the stiffness {place} is {stiffness} {}: the tool returns with a time constant of {time:.0} s",
                units[2]
            );
            add(("stiffness", message, "check the unit: 1 N/mm is 1000 N/m; 0 is no spring at all"));
        }
    }
    let strongest = model.joints.iter().map(|joint| joint.torque_limit()).fold(0.0, f32::max);
    let largest = strongest / (SHORT_LEVER * length);
    if matches!(settings.force, ForceSource::Observer { .. }) && settings.contact_force > largest {
        let message = format!(
            "contact_force = {} N: the strongest motor, {strongest} N·m, presses with {largest:.0} N at a tenth of the \
             arm's length: a contact is never detected",
            settings.contact_force
        );
        add((
            "contact_force",
            message,
            "above the error of the estimate: about 6 N for a light arm, 40 N for a UR5e",
        ));
    }
    found
}
