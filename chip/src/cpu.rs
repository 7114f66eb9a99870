//! Unicorn as a Cortex-M4F: slices that stop exactly, exception entry and return, masks, sleep.

use std::ffi::c_void;
use std::ops::{Deref, DerefMut};
use std::ptr;

use object::{Object, ObjectSegment};
use unicorn_engine::Unicorn;
use unicorn_engine::hook::sys::*;

use crate::bench::Bench;
use crate::chip::Chip;

pub const FLASH: u64 = 0x0800_0000;
const FLASH_SIZE: u64 = 0x10_0000;

/// What the callbacks change while `emu_start` runs. It is accessed only through a raw pointer: if it were a
/// field of `Machine`, the compiler could (and does) assume that a call without `&mut self` leaves it
/// unchanged.
pub struct Shared {
    pub chip: Chip,
    /// Instructions that may still run in this slice; hooks set it to 0 to stop before the next one.
    left: i64,
    /// Calls of the hook in this slice, and the address of the last.
    calls: u64,
    last: u64,
    start: u64,
    /// Picoseconds per instruction at the present clock.
    cost: u64,
    /// Whether a hook requested the stop.
    stopped: bool,
    exception_return: bool,
    other_exception: Option<u32>,
    /// Whether an interrupt is masked by PRIMASK, FAULTMASK or BASEPRI.
    watch: bool,
    /// Unicorn has no hook for MSR and CPS on this core: their addresses in flash, a bit per halfword, are
    /// found by their encoding. (One hook per address would be 10 times slower: the engine walks the list of
    /// all code hooks at each instruction.)
    mask_sites: Vec<u64>,
}

impl Shared {
    fn writes_mask(&self, address: u64) -> bool {
        let half = address.wrapping_sub(FLASH) as usize / 2;
        self.mask_sites.get(half / 64).is_some_and(|word| word >> (half % 64) & 1 == 1)
    }
    pub fn now(&self) -> u64 {
        self.start + self.calls * self.cost
    }
}

/// The instructions that a handler has executed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Work {
    pub times: u64,
    pub instructions: u64,
    /// Instructions of the longest run.
    pub longest: u64,
}

pub struct Machine {
    uc: *mut uc_engine,
    shared: *mut Shared,
    pub instructions: u64,
    /// The instructions that the handlers have executed, by number of the exception.
    pub work: Vec<Work>,
    /// Active handlers: number, instruction count at the entry, instructions of other handlers since.
    running: Vec<(u32, u64, u64)>,
    pub resets: Vec<&'static str>,
    /// When the handlers were last entered [ps since power-on], by number of the exception.
    pub entered: Vec<u64>,
    pub sleeping: bool,
    /// 1: handlers find garbage in the float registers, which is allowed; 2: they also leave it there, to
    /// check that this is detected.
    pub scribble: u8,
    owner: Unicorn<'static, ()>,
}

impl Deref for Machine {
    type Target = Shared;
    fn deref(&self) -> &Shared {
        // SAFETY: made by Box::into_raw, never freed; no reference is held over `emu_start`.
        unsafe { &*self.shared }
    }
}
impl DerefMut for Machine {
    fn deref_mut(&mut self) -> &mut Shared {
        // SAFETY: as above.
        unsafe { &mut *self.shared }
    }
}

const CYCLES_PER_INSTRUCTION_X2: u64 = 3;

impl Machine {
    pub fn load(elf: &[u8], bench: Bench) -> Self {
        let mut owner = Unicorn::new(Arch::ARM, Mode::THUMB | Mode::MCLASS).expect("unicorn");
        owner.ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32).expect("cpu model");
        owner.mem_map(FLASH, FLASH_SIZE, Prot::READ | Prot::EXEC).expect("flash");
        owner.mem_map(0x2000_0000, 0x2_0000, Prot::READ | Prot::WRITE | Prot::EXEC).expect("ram");
        owner.mem_map(0x1000_0000, 0x1_0000, Prot::READ | Prot::WRITE).expect("ccm");
        owner.mem_map(0x1FFF_0000, 0x8000, Prot::READ | Prot::EXEC).expect("system memory");
        let file = object::File::parse(elf).expect("elf");
        flash(&mut owner, &file, elf);
        owner.mem_write(0x1FFF_7A10, b"tesaki-chip1").expect("unique id");
        owner.mem_write(0x1FFF_7A22, &1024u16.to_le_bytes()).expect("flash size");
        owner.mem_write(0x1FFF_7A2A, &1500u16.to_le_bytes()).expect("VREFINT calibration");
        // SRAM contains noise after power-on.
        let noise: Vec<u8> = (0u32..0x2_0000).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        owner.mem_write(0x2000_0000, &noise).expect("ram");

        let uc = owner.get_handle();
        let shared = Box::into_raw(Box::new(Shared {
            chip: Chip::new(bench),
            left: 0,
            calls: 0,
            last: 0,
            start: 0,
            cost: 0,
            stopped: false,
            exception_return: false,
            other_exception: None,
            watch: false,
            mask_sites: mask_sites(&file),
        }));
        let mut machine = Self {
            uc,
            shared,
            instructions: 0,
            work: vec![Work::default(); 256],
            running: Vec::new(),
            resets: Vec::new(),
            entered: vec![0; 256],
            sleeping: false,
            scribble: 0,
            owner,
        };
        let me: *mut c_void = shared.cast();
        let hook = |kind: HookType, callback: *mut c_void, begin: u64, end: u64| {
            let mut id: uc_hook = Default::default();
            // SAFETY: `shared` is never freed.
            let error = unsafe { uc_hook_add(uc, &raw mut id, kind.0 as i32, callback, me, begin, end) };
            assert_eq!(error, uc_error::OK);
        };
        hook(HookType::CODE, on_instruction as *mut c_void, 1, 0);
        hook(HookType::INTR, on_exception as *mut c_void, 1, 0);
        for (begin, size) in [
            (0x4000_0000u64, 0x8_0000u64),
            (0x4200_0000, 0x200_0000),
            (0x5000_0000, 0x7_0000),
            (0xE000_0000, 0x10_0000),
        ] {
            let at = Box::leak(Box::new(Region { shared, base: begin as u32 }));
            let at: *mut c_void = ptr::from_mut(at).cast();
            // SAFETY: as above; the region is leaked.
            let error = unsafe { uc_mmio_map(uc, begin, size, Some(on_read), at, Some(on_write), at) };
            assert_eq!(error, uc_error::OK);
        }
        machine.start_from_vectors();
        machine
    }

    pub fn get(&self, register: RegisterARM) -> u32 {
        let mut value = 0u64;
        // SAFETY: a register is at most eight bytes (D registers are not read here).
        unsafe { uc_reg_read(self.uc, register as i32, (&raw mut value).cast()) };
        value as u32
    }
    pub fn set(&mut self, register: RegisterARM, value: u32) {
        let value = u64::from(value);
        // SAFETY: as above.
        unsafe { uc_reg_write(self.uc, register as i32, (&raw const value).cast()) };
    }
    pub fn word(&self, address: u32) -> u32 {
        let mut bytes = [0; 4];
        // SAFETY: four bytes.
        unsafe { uc_mem_read(self.uc, address.into(), bytes.as_mut_ptr().cast(), 4) };
        u32::from_le_bytes(bytes)
    }
    /// Writes words. Returns false when there is no memory.
    pub fn put(&mut self, address: u32, words: &[u32]) -> bool {
        let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        // SAFETY: the length is that of the slice.
        unsafe {
            uc_mem_write(self.uc, address.into(), bytes.as_ptr().cast(), bytes.len() as u64) == uc_error::OK
        }
    }

    /// Replaces a word of the image. Returns false when there is no memory.
    pub fn patch(&mut self, address: u32, word: u32) -> bool {
        // The engine has translated what was there.
        self.put(address, &[word]) && self.owner.ctl_flush_tb().is_ok()
    }

    fn start_from_vectors(&mut self) {
        use RegisterARM as R;
        self.set(R::XPSR_NZCVQG, 1 << 24);
        self.set(R::CONTROL, 0);
        for mask in [R::PRIMASK, R::FAULTMASK, R::BASEPRI] {
            self.set(mask, 0);
        }
        let (sp, pc) = (self.word(FLASH as u32), self.word(FLASH as u32 + 4));
        self.set(R::R13, sp);
        self.set(R::R14, 0xFFFF_FFFF);
        self.set(R::R15, pc);
        self.sleeping = false;
        self.exception_return = false;
    }

    pub fn reset(&mut self, flag: u32, why: &'static str) {
        self.resets.push(why);
        self.chip.reset(flag);
        self.running.clear();
        self.start_from_vectors();
    }

    /// Runs until `until` [ps], until the CPU sleeps with nothing due before `until`, or until an error.
    pub fn run(&mut self, until: u64) -> Result<(), String> {
        use RegisterARM as R;
        loop {
            let now = self.now();
            if self.chip.advance(now) {
                self.reset(1 << 29, "watchdog");
            }
            if self.chip.nvic.reset_requested {
                self.reset(1 << 28, "software");
            }
            self.start = now;
            self.calls = 0;
            if std::mem::take(&mut self.exception_return) {
                self.leave()?;
                self.chip.advance(now);
            }
            self.watch = false;
            if self.chip.nvic.waits() {
                self.sleeping = false;
                let (primask, faultmask, basepri) =
                    (self.get(R::PRIMASK), self.get(R::FAULTMASK), self.get(R::BASEPRI));
                match self.chip.nvic.due(primask & 1 == 1, faultmask & 1 == 1, basepri as u8) {
                    Some(number) => self.enter(number)?,
                    None => self.watch = true,
                }
            }
            let next = self.chip.next().min(until);
            if self.sleeping {
                self.start = next.max(now);
                if next >= until {
                    return Ok(());
                }
                continue;
            }
            if now >= until {
                return Ok(());
            }
            self.cost = CYCLES_PER_INSTRUCTION_X2 * 500_000_000_000 / self.chip.rcc.hclk();
            self.slice((next - now).div_ceil(self.cost).max(1))?;
        }
    }

    /// Lets time pass while the CPU executes nothing: shows what the hardware does alone.
    pub fn pass(&mut self, duration: u64) {
        let until = self.now() + duration;
        loop {
            let time = self.chip.next().clamp(self.now(), until);
            (self.start, self.calls) = (time, 0);
            self.chip.advance(time);
            if time == until {
                return;
            }
        }
    }

    fn slice(&mut self, instructions: u64) -> Result<(), String> {
        let pc = self.get(RegisterARM::R15);
        let shared = &mut **self;
        (shared.left, shared.calls, shared.stopped, shared.other_exception) =
            (instructions as i64, 0, false, None);
        // SAFETY: the engine lives; callbacks only touch `self` through the pointer given at `load`.
        let error = unsafe { uc_emu_start(self.uc, u64::from(pc) | 1, u64::MAX >> 1, 0, 0) };
        let after = self.get(RegisterARM::R15);
        // The hook was also called for the instruction before which we stopped.
        if self.stopped && u64::from(after) == self.last && !self.exception_return {
            self.calls -= 1;
        }
        self.instructions += self.calls;
        if matches!(
            error,
            uc_error::READ_UNMAPPED
                | uc_error::WRITE_UNMAPPED
                | uc_error::FETCH_UNMAPPED
                | uc_error::WRITE_PROT
                | uc_error::INSN_INVALID
        ) {
            // The firmware does not enable the configurable fault exceptions: all escalate to a hard fault.
            if self.chip.nvic.active_priority() < 0 {
                return Err(format!("lockup: {error:?} at {after:#x}"));
            }
            self.chip.nvic.system_pending |= 1 << 3;
            self.sleeping = false;
            return Ok(());
        }
        if error != uc_error::OK || self.other_exception.is_some() {
            return Err(format!(
                "{error:?}, exception {:?}, pc {after:#x}, lr {:#x}, sp {:#x}, last {:#x}",
                self.other_exception,
                self.get(RegisterARM::R14),
                self.get(RegisterARM::R13),
                self.last
            ));
        }
        // Ended by itself: WFI (its helper leaves the loop as halted).
        self.sleeping = !self.stopped;
        Ok(())
    }

    fn enter(&mut self, number: u32) -> Result<(), String> {
        use RegisterARM as R;
        self.running.push((number, self.instructions, 0));
        let now = self.now();
        self.entered[number as usize] = now;
        self.chip.nvic.enter(number);
        let xpsr = self.get(R::XPSR);
        let control = self.get(R::CONTROL);
        let handler = xpsr & 0x1FF != 0;
        let float = control & 4 != 0;
        let sp = self.get(R::R13);
        let pad = sp >> 2 & 1;
        let bottom = (sp - pad * 4).wrapping_sub(if float { 104 } else { 32 });
        let mut frame = [R::R0, R::R1, R::R2, R::R3, R::R12, R::R14, R::R15].map(|r| self.get(r)).to_vec();
        frame.push(xpsr & !(1 << 9) | pad << 9 | 1 << 24);
        if float {
            frame.extend((0..16).map(|i| self.get_single(i)));
            frame.extend([self.get(R::FPSCR), 0]);
        }
        if !self.put(bottom, &frame) {
            return Err(format!("stacking at {bottom:#x} failed: lockup"));
        }
        self.set(R::R13, bottom);
        self.set(R::CONTROL, control & !4);
        let lr = if handler {
            0xFFFF_FFF1
        } else if control & 2 != 0 {
            0xFFFF_FFFD
        } else {
            0xFFFF_FFF9
        };
        self.set(R::R14, if float { lr & !0x10 } else { lr });
        // Handler mode: without a number in IPSR Unicorn takes the EXC_RETURN for a plain jump.
        self.set(R::XPSR_NZCVQG, xpsr & 0xF80F_0000 | 1 << 24 | number);
        let vector = self.word(self.chip.nvic.vtor + 4 * number);
        self.set(R::R15, vector);
        if float && self.scribble > 0 {
            for i in 0..16 {
                self.set_single(i, 0x7FC0_0000 + i as u32);
            }
        }
        Ok(())
    }

    fn leave(&mut self) -> Result<(), String> {
        use RegisterARM as R;
        let value = self.get(R::R15);
        let number = self.get(R::XPSR) & 0x1FF;
        self.chip.nvic.leave(number);
        self.count(number);
        let float = value & 0x10 == 0;
        let sp = self.get(R::R13);
        let frame: Vec<u32> = (0..if float { 26 } else { 8 }).map(|i| self.word(sp + 4 * i)).collect();
        let xpsr = frame[7];
        if (xpsr & 0x1FF != 0) == (value & 8 != 0) {
            return Err(format!("EXC_RETURN {value:#x} against xpsr {xpsr:#x}"));
        }
        for (register, &word) in [R::R0, R::R1, R::R2, R::R3, R::R12, R::R14].into_iter().zip(&frame) {
            self.set(register, word);
        }
        self.set(R::R13, sp + 4 * frame.len() as u32 + (xpsr >> 9 & 1) * 4);
        if float {
            if self.scribble < 2 {
                for i in 0..16 {
                    self.set_single(i, frame[8 + i as usize]);
                }
            }
            self.set(R::FPSCR, frame[24]);
        }
        let control = self.get(R::CONTROL);
        self.set(R::CONTROL, control & !4 | u32::from(float) << 2);
        self.set(R::XPSR_NZCVQG, xpsr & !(1 << 9));
        self.set(R::R15, frame[6] | 1);
        Ok(())
    }

    /// Adds up the instructions of a handler, without those of handlers that preempted it.
    fn count(&mut self, number: u32) {
        let Some((_, since, others)) = self.running.pop() else { return };
        let all = self.instructions - since;
        let work = &mut self.work[number as usize];
        (work.times, work.instructions) = (work.times + 1, work.instructions + all - others);
        work.longest = work.longest.max(all - others);
        if let Some((_, _, others)) = self.running.last_mut() {
            *others += all;
        }
    }

    fn get_single(&self, i: i32) -> u32 {
        let mut value = 0u32;
        // SAFETY: S registers are four bytes.
        unsafe { uc_reg_read(self.uc, RegisterARM::S0 as i32 + i, (&raw mut value).cast()) };
        value
    }
    fn set_single(&mut self, i: i32, value: u32) {
        // SAFETY: as above.
        unsafe { uc_reg_write(self.uc, RegisterARM::S0 as i32 + i, (&raw const value).cast()) };
    }
}

struct Region {
    shared: *mut Shared,
    base: u32,
}

/// Writes the image's segments to their load addresses, not the virtual ones: `.data` lies in flash.
fn flash(uc: &mut Unicorn<'_, ()>, file: &object::File<'_>, elf: &[u8]) {
    use object::read::elf::ProgramHeader;
    let object::File::Elf32(file) = file else { panic!("not a 32-bit ELF") };
    for header in file.elf_program_headers() {
        let data = header.data(file.endian(), elf).expect("segment");
        if header.p_type(file.endian()) == object::elf::PT_LOAD && !data.is_empty() {
            uc.mem_write(header.p_paddr(file.endian()).into(), data).expect("segment fits");
        }
    }
}

/// Finds where the image changes an interrupt mask, by `msr` or `cps`: a bit for each halfword of the flash.
fn mask_sites(file: &object::File<'_>) -> Vec<u64> {
    let mut sites = vec![0; FLASH_SIZE as usize / 2 / 64];
    let segments = file.segments().filter(|s| (FLASH..FLASH + FLASH_SIZE).contains(&s.address()));
    let Some(text) = segments.max_by_key(ObjectSegment::size) else { return sites };
    let first = (text.address() - FLASH) as usize / 2;
    let bytes = text.data().unwrap_or_default();
    let halves: Vec<u16> = bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    for (site, pair) in (first..).zip(halves.windows(2)) {
        if pair[0] & 0xFFF0 == 0xF380 && matches!(pair[1], 0x8810..=0x8813)
            || matches!(pair[0], 0xB661..=0xB663)
        {
            sites[site / 64] |= 1 << (site % 64);
        }
    }
    sites
}

// The callbacks: Unicorn calls them while `uc_emu_start` runs, one at a time, with the pointers that
// `Machine::load` has given it. These are never freed, and there is no other reference meanwhile.

unsafe extern "C" fn on_instruction(uc: *mut uc_engine, address: u64, _size: u32, me: *mut c_void) {
    // SAFETY: a callback, see above.
    let m = unsafe { &mut *me.cast::<Shared>() };
    m.calls += 1;
    m.last = address;
    m.left -= 1;
    // An interrupt is masked: check again after each instruction that may lower the mask.
    if m.watch && m.writes_mask(address) {
        m.left = m.left.min(0);
    }
    if m.left < 0 {
        m.stopped = true;
        // SAFETY: the engine that calls.
        unsafe { uc_emu_stop(uc) };
    }
}

unsafe extern "C" fn on_exception(uc: *mut uc_engine, number: u32, me: *mut c_void) {
    // SAFETY: a callback, see above.
    let m = unsafe { &mut *me.cast::<Shared>() };
    if number == 8 {
        m.exception_return = true;
    } else {
        m.other_exception = Some(number);
    }
    m.stopped = true;
    // SAFETY: the engine that calls.
    unsafe { uc_emu_stop(uc) };
}

/// Returns the bit to which an address in the peripheral bit band maps.
fn bit(address: u32) -> (u32, u32) {
    let offset = address - 0x4200_0000;
    (0x4000_0000 + ((offset / 32) & !3), offset / 4 % 32)
}

unsafe extern "C" fn on_read(_uc: *mut uc_engine, offset: u64, size: u32, region: *mut c_void) -> u64 {
    // SAFETY: a callback, see above.
    let region = unsafe { &mut *region.cast::<Region>() };
    // SAFETY: the same.
    let m = unsafe { &mut *region.shared };
    let address = region.base + offset as u32;
    let now = m.now();
    let value = if region.base == 0x4200_0000 {
        let (word, bit) = bit(address);
        m.chip.read(word, now) >> bit & 1
    } else {
        let word = m.chip.read(address & !3, now) >> (8 * (address & 3));
        if size == 4 { word } else { word & ((1 << (8 * size)) - 1) }
    };
    value.into()
}

unsafe extern "C" fn on_write(_uc: *mut uc_engine, offset: u64, size: u32, value: u64, region: *mut c_void) {
    // SAFETY: a callback, see above.
    let region = unsafe { &mut *region.cast::<Region>() };
    // SAFETY: the same.
    let m = unsafe { &mut *region.shared };
    let address = region.base + offset as u32;
    let now = m.now();
    let value = value as u32;
    if region.base == 0x4200_0000 {
        let (word, bit) = bit(address);
        let old = m.chip.read(word, now);
        m.chip.write(word, 4, old & !(1 << bit) | (value & 1) << bit, now);
    } else if size == 4 || region.base == 0xE000_0000 {
        m.chip.write(address, size, value, now);
    } else {
        // Most peripheral buses of the chip take a narrow write as a whole word with the value repeated.
        let shift = 8 * (address & 3);
        let mask = ((1u32 << (8 * size)) - 1) << shift;
        let old = m.chip.peek(address & !3, now);
        m.chip.write(address & !3, 4, old & !mask | value << shift & mask, now);
    }
    // An event, an interrupt or the clock may have changed: check before the next instruction.
    let clock = (0x4002_3800..=0x4002_3808).contains(&address);
    if clock || m.chip.nvic.waits() || m.chip.nvic.reset_requested {
        m.left = 0;
    } else {
        let next = m.chip.next();
        m.left = m.left.min((next.saturating_sub(now) / m.cost.max(1)) as i64 + 1);
    }
}
