//! Mistakes in what the driver writes to registers: each must fail the acceptance of the board, in the part
//! that is for it.

use crate::rig::Rig;
use crate::rig::acceptance::{
    Part, accept_part, counts_no_disturbance, is_watched, moves, stops_by_hardware, survives_a_low_supply,
    survives_the_crystal,
};
use tesaki_chip::mistake::Mistake;

/// Description, address, mask, value.
type Seeded = (&'static str, u32, u32, u32);

/// The part of the acceptance test that finds them.
const MISTAKES: &[(Part, &[Seeded])] = &[
    (
        moves,
        &[
            ("TIM1 BDTR: no MOE", 0x4001_0044, 1 << 15, 0),
            ("TIM1 BDTR: BKP active high", 0x4001_0044, 1 << 13, 1 << 13),
            ("TIM1 CCER: CC1NP", 0x4001_0020, 1 << 3, 1 << 3),
            ("TIM1 CCER: no CC2NE", 0x4001_0020, 1 << 6, 0),
            ("TIM1 CCER: CC3E, the complement", 0x4001_0020, 1 << 8, 1 << 8),
            ("TIM1 CR2: no trigger output", 0x4001_0004, 7 << 4, 0),
            ("TIM1 CCMR1: channel 1 in PWM mode 2", 0x4001_0018, 7 << 4, 7 << 4),
            ("TIM1 CCMR1: channel 2 frozen", 0x4001_0018, 7 << 12, 0),
            ("TIM1 CCMR2: channel 3 forced active", 0x4001_001C, 7 << 4, 5 << 4),
            ("TIM1 CR1: edge-aligned", 0x4001_0000, 3 << 5, 0),
            ("TIM1 CR1: no CEN", 0x4001_0000, 1, 0),
            ("TIM1 ARR: half", 0x4001_002C, 0xFFFF, 1050),
            ("TIM1 PSC: 1", 0x4001_0028, 0xFFFF, 1),
            ("TIM1 CCR4: beyond the top", 0x4001_0040, 0xFFFF, 2500),
            ("ADC1 CR2: no JEXTEN", 0x4001_2008, 3 << 20, 0),
            ("ADC1 CR2: JEXTSEL TIM1 CC4", 0x4001_2008, 15 << 16, 0),
            ("ADC2 CR2: no ADON", 0x4001_2108, 1, 0),
            ("ADC1 JSQR: supply and current exchanged", 0x4001_2038, 0x3FF << 10, (13 << 10) | (10 << 15)),
            ("ADC2 JSQR: another motor's channel", 0x4001_2138, 31 << 15, 12 << 15),
            ("ADC1 CR1: no JEOCIE", 0x4001_2004, 1 << 7, 0),
            ("ADC1 CR1: no SCAN", 0x4001_2004, 1 << 8, 0),
            ("ADC CCR: 42 MHz", 0x4001_2304, 3 << 16, 0),
            ("RCC: TIM1 without clock", 0x4002_3844, 1, 0),
            ("RCC: ADC2 without clock", 0x4002_3844, 1 << 9, 0),
            ("RCC: TIM4 without clock", 0x4002_3840, 1 << 2, 0),
            ("RCC: PLLN 168", 0x4002_3804, 0x1FF << 6, 168 << 6),
            ("FLASH: no wait states", 0x4002_3C00, 7, 0),
            ("PB13 AF2", 0x4002_0424, 15 << 20, 2 << 20),
            ("PC7 AF3", 0x4002_0820, 15 << 28, 3 << 28),
            ("PA10 AF8", 0x4002_0024, 15 << 8, 8 << 8),
            ("PC5 an input", 0x4002_0800, 3 << 10, 0),
            ("PC0 not analogue", 0x4002_0800, 3, 0),
            ("PB1 an input", 0x4002_0400, 3 << 2, 0),
            ("TIM3 SMCR: encoder mode 2", 0x4000_0408, 7, 2),
            ("TIM4 CCER: CC1P", 0x4000_0820, 1 << 1, 1 << 1),
            ("TIM5 ARR: 16 bits", 0x4000_0C2C, u32::MAX, 0xFFFF),
        ],
    ),
    (
        stops_by_hardware,
        &[
            ("TIM1 BDTR: AOE", 0x4001_0044, 1 << 14, 1 << 14),
            ("TIM1 BDTR: no BKE", 0x4001_0044, 1 << 12, 0),
            ("TIM1 BDTR: no OSSI", 0x4001_0044, 1 << 10, 0),
            ("PA6 AF0", 0x4002_0020, 15 << 24, 0),
        ],
    ),
    (
        counts_no_disturbance,
        &[
            ("TIM3 CCMR1: no filter of channel 1 and 2", 0x4000_0418, 0xF0F0, 0),
            ("TIM5 CCMR1: a filter of 24 ns", 0x4000_0C18, 0xF0F0, 0x1010),
        ],
    ),
    (survives_the_crystal, &[("RCC: no CSSON", 0x4002_3800, 1 << 19, 0)]),
    (
        survives_a_low_supply,
        &[
            ("PWR CR: no PVDE", 0x4000_7000, 1 << 4, 0),
            ("PWR CR: PLS 3", 0x4000_7000, 7 << 5, 3 << 5),
            ("RCC: PWR without clock", 0x4002_3840, 1 << 28, 0),
            ("EXTI RTSR: the supply does not matter", 0x4001_3C08, 1 << 16, 0),
            ("EXTI IMR: PVD masked", 0x4001_3C00, 1 << 16, 0),
        ],
    ),
    (is_watched, &[("IWDG: not started", 0x4000_3000, 0xFFFF, 0)]),
];

#[test]
fn every_seeded_mistake_is_found() {
    let mut missed = Vec::new();
    for &(part, mistakes) in MISTAKES {
        accept_part(&mut Rig::boot(), part).unwrap();
        for &(name, address, mask, value) in mistakes {
            match accept_part(&mut Rig::boot_with(&[Mistake { address, mask, value }]), part) {
                Ok(()) => missed.push(name),
                Err(found) => println!("{name}: {found}"),
            }
        }
    }
    assert!(missed.is_empty(), "missed: {missed:?}");
}
