//! Runs libFuzzer on a target, or the inputs of a corpus one by one; `cargo xtask fuzz` calls it.
#![expect(unsafe_code, reason = "libFuzzer and the tables of the instrumentation are not Rust")]

mod coverage;

use std::ffi::{CString, c_char, c_int};
use std::path::Path;
use std::process::exit;
use std::sync::OnceLock;

use libfuzzer_sys as _;
use tesaki_fuzz::{TARGETS, Target, corpus};

/// Maximum memory of a run, including the instrumentation [bytes].
const MEMORY: u64 = 1 << 30;
/// Stack of the handler that saves the input after a stack overflow [bytes].
const HANDLER_STACK: usize = 256 * 1024;

static TARGET: OnceLock<Target> = OnceLock::new();

unsafe extern "C" {
    fn LLVMFuzzerRunDriver(
        argc: *mut c_int,
        argv: *mut *mut *mut c_char,
        run: extern "C" fn(*const u8, usize) -> c_int,
    ) -> c_int;
}

/// Called by libFuzzer's crate, but unused: this program calls libFuzzer's driver itself.
// SAFETY: no other function has this name.
#[unsafe(no_mangle)]
extern "Rust" fn rust_fuzzer_test_input(_: &[u8]) -> i32 {
    0
}

extern "C" fn run(data: *const u8, size: usize) -> c_int {
    // SAFETY: libFuzzer passes a buffer of this size, which may be null when it is empty.
    let data = if size == 0 { &[] } else { unsafe { std::slice::from_raw_parts(data, size) } };
    if let Some(target) = TARGET.get() {
        (target.run)(data);
    }
    0
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let words: Vec<&str> = arguments.iter().skip(1).map(String::as_str).collect();
    match &*words {
        ["list"] => {
            TARGETS.iter().for_each(|target| println!("{} {}", target.name, target.modules.join(" ")))
        }
        ["unpack", name, folder] => unpack(&find(name), Path::new(folder)),
        ["pack", name, folder] => coverage::pack(&find(name), Path::new(folder)),
        ["run", name, options @ ..] => fuzz(find(name), options),
        _ => {
            eprintln!(
                "tesaki-fuzz list | unpack TARGET FOLDER | pack TARGET FOLDER | run TARGET [OPTION OF LIBFUZZER]…"
            );
            exit(2);
        }
    }
}

fn find(name: &str) -> Target {
    *TARGETS.iter().find(|target| target.name == name).unwrap_or_else(|| {
        eprintln!("there is no target {name}");
        exit(2)
    })
}

/// Writes seeds, kept inputs and past crashes as files, and the words beside them.
fn unpack(target: &Target, folder: &Path) {
    let seeds = (target.seeds)().into_iter().chain(corpus::kept(target));
    let crashes = corpus::crashes(target).into_iter().map(|(_, input)| input);
    let inputs = folder.join("corpus");
    std::fs::create_dir_all(&inputs).expect("the folder can be made");
    for (index, input) in seeds.chain(crashes).enumerate() {
        std::fs::write(inputs.join(format!("kept-{index:04}")), input).expect("the folder takes files");
    }
    if target.words.is_empty() {
        return;
    }
    let quoted = |word: &&str| format!("\"{}\"\n", word.replace('\\', "\\\\").replace('"', "\\\""));
    std::fs::write(folder.join("words"), target.words.iter().map(quoted).collect::<String>())
        .expect("the folder takes files");
}

fn fuzz(target: Target, options: &[&str]) {
    let _ = TARGET.set(target);
    limit();
    let length = format!("-max_len={}", target.max_len);
    let words = ["tesaki-fuzz", &length].into_iter().chain(options.iter().copied());
    let owned: Vec<CString> = words.filter_map(|word| CString::new(word).ok()).collect();
    let mut pointers: Vec<*mut c_char> = owned.iter().map(|word| word.as_ptr().cast_mut()).collect();
    let mut count = c_int::try_from(pointers.len()).unwrap_or(c_int::MAX);
    pointers.push(std::ptr::null_mut());
    let mut start = pointers.as_mut_ptr();
    // SAFETY: `argc` pointers to strings, followed by a null; all live until the driver returns.
    exit(unsafe { LLVMFuzzerRunDriver(&raw mut count, &raw mut start, run) });
}

/// Limits the memory, so that a large allocation aborts, and gives signal handlers a stack on which libFuzzer
/// can save the input that overflowed the other one.
fn limit() {
    let stack = Vec::leak(vec![0_u8; HANDLER_STACK]);
    let stack = libc::stack_t { ss_sp: stack.as_mut_ptr().cast(), ss_flags: 0, ss_size: HANDLER_STACK };
    let memory = libc::rlimit { rlim_cur: MEMORY, rlim_max: MEMORY };
    // SAFETY: both structures are complete, and the stack is never freed.
    let failed = unsafe {
        libc::sigaltstack(&raw const stack, std::ptr::null_mut())
            | libc::setrlimit(libc::RLIMIT_AS, &raw const memory)
    };
    assert_eq!(failed, 0, "limits can be set");
}
