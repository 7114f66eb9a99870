//! Which edges an input covers, from the tables of the instrumentation, and the smallest corpus that covers
//! them all.

use std::io::Write;
use std::path::Path;

use tesaki_fuzz::{Target, corpus};

/// Maximum size of a kept corpus [bytes].
const MAX_CORPUS: usize = 190_000;

unsafe extern "C" {
    #[link_name = "__start___sancov_cntrs"]
    static mut COUNTERS: u8;
    #[link_name = "__stop___sancov_cntrs"]
    static mut COUNTERS_END: u8;
    /// For each counter, the address of its edge, and whether a function begins there.
    #[link_name = "__start___sancov_pcs"]
    static EDGES: [usize; 2];
}

fn counters() -> &'static mut [u8] {
    // SAFETY: the linker puts the two symbols around the counters, to which there is no other reference.
    unsafe {
        let start = &raw mut COUNTERS;
        let length = (&raw mut COUNTERS_END).offset_from_unsigned(start);
        std::slice::from_raw_parts_mut(start, length)
    }
}

fn edges() -> &'static [[usize; 2]] {
    // SAFETY: the table has an entry for each counter.
    unsafe { std::slice::from_raw_parts(&raw const EDGES, counters().len()) }
}

/// Runs every file in the subfolder `corpus` of `folder`. The shortest ones that cover everything become
/// `packed.bin`; the file `edges` lists each edge: address, whether a function begins there, whether it is
/// covered.
pub fn pack(target: &Target, folder: &Path) {
    let files = std::fs::read_dir(folder.join("corpus")).into_iter().flatten().flatten();
    let mut inputs: Vec<Vec<u8>> = files.filter_map(|file| std::fs::read(file.path()).ok()).collect();
    inputs.sort_by_key(|input| (input.len(), input.clone()));
    // Code that runs only once must not be attributed to the first input.
    inputs.iter().take(1).for_each(|input| (target.run)(input));
    let mut covered = vec![false; counters().len()];
    let mut kept = Vec::new();
    let mut size = 0;
    for input in inputs {
        counters().fill(0);
        (target.run)(&input);
        let mut new = false;
        for (seen, count) in covered.iter_mut().zip(counters().iter()) {
            new |= *count > 0 && !*seen;
            *seen |= *count > 0;
        }
        if new && size + input.len() + 4 <= MAX_CORPUS {
            size += input.len() + 4;
            kept.push(input);
        }
    }
    std::fs::write(folder.join("packed.bin"), corpus::pack(&kept)).expect("the folder takes files");
    let mut file =
        std::io::BufWriter::new(std::fs::File::create(folder.join("edges")).expect("it takes files"));
    // Addresses are relative to one that can be found in the program.
    let origin = super::rust_fuzzer_test_input as fn(&[u8]) -> i32 as usize;
    for ([address, flags], covered) in edges().iter().zip(&covered) {
        let line = writeln!(file, "{} {} {}", address.wrapping_sub(origin), flags & 1, u8::from(*covered));
        line.expect("the folder takes files");
    }
    println!("{} {size}", kept.len());
}
