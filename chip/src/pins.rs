//! Which peripheral a pin belongs to: the alternate functions of the STM32F405 (datasheet DS8626, table 9),
//! for the peripherals that this crate models.

use std::sync::LazyLock;

/// A pin: port (0 is A) and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pin(pub usize, pub u32);

impl Pin {
    /// Parses a name such as `PB13`.
    pub fn named(name: &str) -> Option<Self> {
        let mut characters = name.strip_prefix('P')?.chars();
        let port = (characters.next()? as usize).checked_sub('A' as usize)?;
        let number = characters.as_str().parse().ok()?;
        (port < PORTS && number < 16).then_some(Self(port, number))
    }
}

impl std::fmt::Display for Pin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "P{}{}", (b'A' + self.0 as u8) as char, self.1)
    }
}

/// A signal, by peripheral and name.
pub type Signal = (&'static str, &'static str);

/// Pin, number of the alternate function, signal.
const TABLE: &[(&str, u32, Signal)] = &[
    ("PA8", 1, ("TIM1", "CH1")),
    ("PA9", 1, ("TIM1", "CH2")),
    ("PA10", 1, ("TIM1", "CH3")),
    ("PA11", 1, ("TIM1", "CH4")),
    ("PA7", 1, ("TIM1", "CH1N")),
    ("PB13", 1, ("TIM1", "CH1N")),
    ("PB0", 1, ("TIM1", "CH2N")),
    ("PB14", 1, ("TIM1", "CH2N")),
    ("PB1", 1, ("TIM1", "CH3N")),
    ("PB15", 1, ("TIM1", "CH3N")),
    ("PA6", 1, ("TIM1", "BKIN")),
    ("PB12", 1, ("TIM1", "BKIN")),
    ("PA12", 1, ("TIM1", "ETR")),
    ("PA0", 1, ("TIM2", "CH1")),
    ("PA5", 1, ("TIM2", "CH1")),
    ("PA15", 1, ("TIM2", "CH1")),
    ("PA1", 1, ("TIM2", "CH2")),
    ("PB3", 1, ("TIM2", "CH2")),
    ("PA2", 1, ("TIM2", "CH3")),
    ("PB10", 1, ("TIM2", "CH3")),
    ("PA3", 1, ("TIM2", "CH4")),
    ("PB11", 1, ("TIM2", "CH4")),
    ("PA6", 2, ("TIM3", "CH1")),
    ("PB4", 2, ("TIM3", "CH1")),
    ("PC6", 2, ("TIM3", "CH1")),
    ("PA7", 2, ("TIM3", "CH2")),
    ("PB5", 2, ("TIM3", "CH2")),
    ("PC7", 2, ("TIM3", "CH2")),
    ("PB0", 2, ("TIM3", "CH3")),
    ("PC8", 2, ("TIM3", "CH3")),
    ("PB1", 2, ("TIM3", "CH4")),
    ("PC9", 2, ("TIM3", "CH4")),
    ("PB6", 2, ("TIM4", "CH1")),
    ("PB7", 2, ("TIM4", "CH2")),
    ("PB8", 2, ("TIM4", "CH3")),
    ("PB9", 2, ("TIM4", "CH4")),
    ("PA0", 2, ("TIM5", "CH1")),
    ("PA1", 2, ("TIM5", "CH2")),
    ("PA2", 2, ("TIM5", "CH3")),
    ("PA3", 2, ("TIM5", "CH4")),
    ("PC6", 3, ("TIM8", "CH1")),
    ("PC7", 3, ("TIM8", "CH2")),
    ("PC8", 3, ("TIM8", "CH3")),
    ("PC9", 3, ("TIM8", "CH4")),
    ("PA6", 3, ("TIM8", "BKIN")),
    ("PA7", 3, ("TIM8", "CH1N")),
    ("PB0", 3, ("TIM8", "CH2N")),
    ("PB1", 3, ("TIM8", "CH3N")),
    ("PB14", 3, ("TIM8", "CH2N")),
    ("PB15", 3, ("TIM8", "CH3N")),
    ("PA5", 5, ("SPI1", "SCK")),
    ("PA6", 5, ("SPI1", "MISO")),
    ("PA7", 5, ("SPI1", "MOSI")),
    ("PB3", 5, ("SPI1", "SCK")),
    ("PB4", 5, ("SPI1", "MISO")),
    ("PB5", 5, ("SPI1", "MOSI")),
    ("PB3", 6, ("SPI3", "SCK")),
    ("PB4", 6, ("SPI3", "MISO")),
    ("PB5", 6, ("SPI3", "MOSI")),
    ("PC10", 6, ("SPI3", "SCK")),
    ("PC11", 6, ("SPI3", "MISO")),
    ("PC12", 6, ("SPI3", "MOSI")),
    ("PA9", 7, ("USART1", "TX")),
    ("PB6", 7, ("USART1", "TX")),
    ("PA10", 7, ("USART1", "RX")),
    ("PB7", 7, ("USART1", "RX")),
    ("PA2", 7, ("USART2", "TX")),
    ("PA3", 7, ("USART2", "RX")),
    ("PA0", 8, ("UART4", "TX")),
    ("PC10", 8, ("UART4", "TX")),
    ("PA1", 8, ("UART4", "RX")),
    ("PC11", 8, ("UART4", "RX")),
];

/// [`TABLE`] by port, number and alternate function: a fast lookup, as it is used at each event of the chip.
static SIGNALS: LazyLock<Vec<Option<Signal>>> = LazyLock::new(|| {
    let mut signals = vec![None; PORTS * 16 * 16];
    for &(name, function, signal) in TABLE {
        if let Some(pin) = Pin::named(name) {
            signals[index(pin, function)] = Some(signal);
        }
    }
    signals
});
const PORTS: usize = 9;

fn index(Pin(port, number): Pin, function: u32) -> usize {
    (port * 16 + number as usize) * 16 + function as usize
}

/// Returns the signal of a pin with this alternate function, if this crate knows one.
pub fn signal(pin: Pin, function: u32) -> Option<Signal> {
    SIGNALS[index(pin, function)]
}
