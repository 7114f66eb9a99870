use crate::purpose::Purpose;

/// Factors by which a joint, and the link that it moves, differ from the model; 1 means no difference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointFactors {
    /// Mass of the link.
    pub mass: f64,
    /// Inertia of the link about its centre of mass.
    pub inertia: f64,
    /// Reflected inertia of the rotor.
    pub rotor_inertia: f64,
    /// Coulomb friction.
    pub coulomb: f64,
    /// Viscous friction.
    pub viscous: f64,
    /// Torque constant.
    pub torque_constant: f64,
}

impl JointFactors {
    /// No difference.
    pub const NONE: Self = Self {
        mass: 1.0,
        inertia: 1.0,
        rotor_inertia: 1.0,
        coulomb: 1.0,
        viscous: 1.0,
        torque_constant: 1.0,
    };
}

/// Draws independent factors, uniform in 1 ± `spread`.
pub fn draw(seed: u64, spread: f64, joints: usize) -> Vec<JointFactors> {
    let mut rng = Purpose::Factors.rng(seed);
    let mut factor = || 1.0 + spread * rng.symmetric();
    (0..joints)
        .map(|_| JointFactors {
            mass: factor(),
            inertia: factor(),
            rotor_inertia: factor(),
            coulomb: factor(),
            viscous: factor(),
            torque_constant: factor(),
        })
        .collect()
}
