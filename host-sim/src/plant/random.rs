use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// What a random number is for. Each purpose has a stream of its own, so that a new use never shifts another's numbers.
/// The numbers are part of every recorded seed: never reuse one.
#[derive(Clone, Copy)]
pub enum Purpose {
    Factors = 0,
    Homing = 1,
    PowerOn = 2,
    Noise = 3,
    Contact = 4,
    ForceSensors = 5,
    ForceNoise = 6,
    Placement = 7,
    HandMotion = 8,
    Tremor = 9,
    MasterArm = 10,
    ElbowSensor = 11,
    Link = 12,
}

/// Seeded random numbers, the same on every machine.
#[derive(Clone, Debug)]
pub struct Random(ChaCha8Rng);

impl Random {
    pub fn new(seed: u64, purpose: Purpose) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(purpose as u64);
        Self(rng)
    }

    /// Uniform in −1 to 1.
    pub fn symmetric(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }

    /// Normal with deviation 1.
    pub fn normal(&mut self) -> f64 {
        let (radius, angle) = (1.0 - self.unit(), self.unit());
        libm::sqrt(-2.0 * libm::log(radius)) * libm::cos(core::f64::consts::TAU * angle)
    }

    /// Uniform in 0 to 1, 1 excluded.
    fn unit(&mut self) -> f64 {
        const SCALE: f64 = 1.0 / 9_007_199_254_740_992.0; // 2⁻⁵³
        #[expect(clippy::cast_precision_loss, reason = "53 bits are exact")]
        let bits = (self.0.next_u64() >> 11) as f64;
        bits * SCALE
    }
}
