//! Motors that many robots have, as a joint sees them: through the gear.

/// A motor with its gear, amplifier and encoder. Values are those at the joint.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorPreset {
    /// Name on the command line.
    pub id: &'static str,
    /// What it is, and where the values come from.
    pub source: &'static str,
    /// Torque for one ampere [N·m/A].
    pub torque_constant: f32,
    /// Largest current, for short times [A].
    pub current: f32,
    /// Rotor and gear [kg·m²].
    pub rotor_inertia: f32,
    /// Speed without load [rad/s].
    pub speed: f32,
    /// Coulomb friction [N·m].
    pub coulomb: f32,
    /// Viscous friction [N·m·s/rad].
    pub viscous: f32,
    /// Encoder counts for a turn of the joint.
    pub counts_per_turn: f32,
    /// Whether the encoder forgets its angle when it is switched off.
    pub relative: bool,
    /// Nominal supply [V].
    pub supply: f32,
    /// Where torque constant and current come from.
    pub torque_source: &'static str,
    /// Where the rotor inertia comes from.
    pub rotor_source: &'static str,
    /// Where the friction comes from.
    pub friction_source: &'static str,
    /// What the encoder is.
    pub encoder_source: &'static str,
}

/// The name of the motor that is sized by the URDF's limits.
pub const GENERIC: &str = "generic";

/// Largest effort in a URDF that is believed [N·m], unless the robot is heavy: then up to this multiple of
/// its largest gravity torque.
pub const LARGEST_EFFORT: f32 = 200.0;
pub const EFFORT_OVER_GRAVITY: f32 = 20.0;

const FRICTION: &str = "assumed, not in the data sheet: identify it";

/// The presets, the weakest first.
pub const PRESETS: &[MotorPreset] = &[
    MotorPreset {
        id: "xl330-m288",
        source: "Dynamixel XL330-M288-T at 5 V, emanual.robotis.com/docs/en/dxl/x/xl330-m288",
        torque_constant: 0.354,
        current: 1.47,
        rotor_inertia: 9.6e-4,
        speed: 10.8,
        coulomb: 0.03,
        viscous: 0.002,
        counts_per_turn: 4096.0,
        relative: false,
        supply: 5.0,
        torque_source: "data sheet: 0.52 N·m at 1.47 A when stalled",
        rotor_source: "assumed: 20 ms mechanical time constant",
        friction_source: FRICTION,
        encoder_source: "data sheet: 12 bit, absolute, at the output",
    },
    MotorPreset {
        id: "maxon-16mm",
        source: "16 mm DC motor as maxon DCX 16 L at 24 V with a planetary gear 111:1, rounded \
            values of the maxon catalogue",
        torque_constant: 1.8,
        current: 0.35,
        rotor_inertia: 1.4e-3,
        speed: 9.5,
        coulomb: 0.03,
        viscous: 0.003,
        counts_per_turn: 454_656.0,
        relative: true,
        supply: 24.0,
        torque_source: "20 mN·m/A · 111 · 0.8 (gear efficiency); current: rating of the gear, 0.6 N·m",
        rotor_source: "1.1 g·cm² · 111²",
        friction_source: FRICTION,
        encoder_source: "1024 lines at the motor, counted fourfold, · 111; relative",
    },
    MotorPreset {
        id: "gl40-kv70",
        source: "T-Motor/CubeMars GL40 KV70 gimbal motor, direct drive, at 24 V, data sheet",
        torque_constant: 0.136,
        current: 5.35,
        rotor_inertia: 1.3e-5,
        speed: 176.0,
        coulomb: 0.01,
        viscous: 1e-4,
        counts_per_turn: 16384.0,
        relative: false,
        supply: 24.0,
        torque_source: "60/(2π·70) N·m/A; data sheet: 0.73 N·m peak, 0.25 N·m continuous",
        rotor_source: "assumed: 40 g at a radius of 18 mm",
        friction_source: FRICTION,
        encoder_source: "14 bit, absolute, at the output",
    },
    MotorPreset {
        id: "odri-4004",
        source: "T-Motor Antigravity 4004 KV300 with belts 9:1 at 24 V (Grimminger et al. 2020, An \
            Open Torque-Controlled Modular Robot Architecture)",
        torque_constant: 0.225,
        current: 12.0,
        rotor_inertia: 3.6e-4,
        speed: 83.8,
        coulomb: 0.05,
        viscous: 0.001,
        counts_per_turn: 180_000.0,
        relative: true,
        supply: 24.0,
        torque_source: "paper: 0.025 N·m/A · 9, 2.7 N·m at 12 A",
        rotor_source: "4.5e-6 kg·m² · 9²",
        friction_source: FRICTION,
        encoder_source: "5000 lines at the motor, counted fourfold, · 9; relative",
    },
    MotorPreset {
        id: "sts3215",
        source: "Feetech STS3215 (C018, 345:1) at 12 V, as in the SO-101, data sheet",
        torque_constant: 1.09,
        current: 2.7,
        rotor_inertia: 0.028,
        speed: 4.71,
        coulomb: 0.052,
        viscous: 0.02,
        counts_per_turn: 4096.0,
        relative: false,
        supply: 12.0,
        torque_source: "data sheet: 30 kg·cm at 2.7 A when stalled",
        rotor_source: "identified: armature of the SO-101's MuJoCo model",
        friction_source: "identified: frictionloss of the SO-101's MuJoCo model; viscous part assumed",
        encoder_source: "data sheet: 12 bit, absolute, at the output",
    },
    MotorPreset {
        id: "xm430-w350",
        source: "Dynamixel XM430-W350 at 12 V, emanual.robotis.com/docs/en/dxl/x/xm430-w350",
        torque_constant: 1.783,
        current: 2.3,
        rotor_inertia: 8.5e-3,
        speed: 4.82,
        coulomb: 0.1,
        viscous: 0.02,
        counts_per_turn: 4096.0,
        relative: false,
        supply: 12.0,
        torque_source: "data sheet: 4.1 N·m at 2.3 A when stalled",
        rotor_source: "assumed: 10 ms mechanical time constant (coreless motor)",
        friction_source: FRICTION,
        encoder_source: "data sheet: 12 bit, absolute, at the output",
    },
    MotorPreset {
        id: "ak60-6",
        source: "T-Motor/CubeMars AK60-6 KV80 at 24 V, data sheet",
        torque_constant: 0.716,
        current: 12.6,
        rotor_inertia: 8.77e-4,
        speed: 33.5,
        coulomb: 0.15,
        viscous: 0.005,
        counts_per_turn: 98304.0,
        relative: true,
        supply: 24.0,
        torque_source: "60/(2π·80) N·m/A · 6; data sheet: 9 N·m peak, 3 N·m continuous",
        rotor_source: "data sheet: 243.5 g·cm² · 6²",
        friction_source: FRICTION,
        encoder_source: "14 bit at the motor, · 6: not absolute at the joint",
    },
    MotorPreset {
        id: "ak10-9",
        source: "T-Motor/CubeMars AK10-9 KV60 at 48 V, data sheet",
        torque_constant: 1.432,
        current: 33.5,
        rotor_inertia: 8.1e-3,
        speed: 33.5,
        coulomb: 0.5,
        viscous: 0.02,
        counts_per_turn: 147_456.0,
        relative: true,
        supply: 48.0,
        torque_source: "60/(2π·60) N·m/A · 9; data sheet: 48 N·m peak, 18 N·m continuous",
        rotor_source: "data sheet: 1002 g·cm² · 9²",
        friction_source: FRICTION,
        encoder_source: "14 bit at the motor, · 9: not absolute at the joint",
    },
    MotorPreset {
        id: "ak80-64",
        source: "T-Motor/CubeMars AK80-64 KV80 at 48 V, data sheet",
        torque_constant: 7.64,
        current: 15.7,
        rotor_inertia: 0.231,
        speed: core::f32::consts::TAU,
        coulomb: 2.0,
        viscous: 0.3,
        counts_per_turn: 1_048_576.0,
        relative: true,
        supply: 48.0,
        torque_source: "60/(2π·80) N·m/A · 64; data sheet: 120 N·m peak, 48 N·m continuous",
        rotor_source: "data sheet: 564.5 g·cm² · 64²",
        friction_source: FRICTION,
        encoder_source: "14 bit at the motor, · 64: not absolute at the joint",
    },
];

impl MotorPreset {
    /// Largest torque [N·m].
    pub const fn torque(&self) -> f32 {
        self.torque_constant * self.current
    }

    /// The preset called `id`.
    pub fn find(id: &str) -> Option<&'static Self> {
        PRESETS.iter().find(|preset| preset.id == id)
    }

    /// The names of all motors.
    pub fn names() -> Vec<&'static str> {
        PRESETS.iter().map(|preset| preset.id).chain([GENERIC]).collect()
    }

    /// The weakest preset with `torque` [N·m]; a motor of just this size and `speed` [rad/s] when that would
    /// be more than three times too strong, or none is strong enough.
    pub fn for_torque(torque: f32, speed: f32) -> Self {
        let enough = PRESETS.iter().filter(|preset| preset.torque() >= 0.99 * torque);
        let weakest = enough.min_by(|one, other| one.torque().total_cmp(&other.torque()));
        match weakest.filter(|preset| preset.torque() <= 3.0 * torque) {
            Some(preset) => preset.clone(),
            None => Self::generic(torque, speed),
        }
    }

    /// A geared motor with a peak `torque` [N·m] and a `speed` without load [rad/s].
    pub fn generic(torque: f32, speed: f32) -> Self {
        Self {
            id: GENERIC,
            source: "no product: a geared motor that has the URDF's effort and velocity; replace its values by \
                your motor's",
            torque_constant: torque / 10.0,
            current: 10.0,
            rotor_inertia: 0.02 * torque / speed,
            speed,
            coulomb: 0.04 * torque,
            viscous: 0.02 * torque / speed,
            counts_per_turn: 262_144.0,
            relative: false,
            supply: 48.0,
            torque_source: "assumed: 10 A at the URDF's effort",
            rotor_source: "assumed: 20 ms mechanical time constant",
            friction_source: "assumed: 4 % of the effort; 2 % more at the largest speed",
            encoder_source: "assumed: 18 bit, absolute, at the output",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weakest_motor_that_is_strong_enough_is_chosen_and_none_that_is_much_too_strong() {
        for (torque, id) in [
            (0.5, "xl330-m288"),
            (0.6, "maxon-16mm"),
            (2.9, "sts3215"),
            (9.0, "ak60-6"),
            (10.0, GENERIC),
            (30.0, "ak10-9"),
            (60.0, "ak80-64"),
            (150.0, GENERIC),
        ] {
            assert_eq!(MotorPreset::for_torque(torque, 5.0).id, id, "{torque} N·m");
        }
    }

    #[test]
    fn no_rotor_is_faster_than_a_motor_can_be() {
        for preset in PRESETS {
            let time = preset.rotor_inertia * preset.speed / preset.torque();
            assert!((1.5e-3..0.06).contains(&time), "{}: {time} s", preset.id);
            assert!(preset.coulomb < 0.1 * preset.torque(), "{}", preset.id);
        }
    }
}
