//! `tesaki follow` with another board: an arm that leads, and feels what the other one touches.

use std::process::Stdio;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;

use serde_json::Value;

use super::follow::{Hand, Leading, arm, distance, file_of, is_clutch, numbers};
use super::server::{Server, signal};

/// The links lose one frame in twenty, repeat some and delay one in ten.
#[test]
fn an_arm_leads_another_over_a_bad_link() {
    let (master, slave) = (arm(), arm());
    let is_closed = |value: &Value| is_clutch(value, "closed", "");
    let (led, stdin) = Leading::start(&master, &[]);
    let mut hand = Hand::new(stdin);
    hand.until("the master follows a hand", || led.count(is_closed) == 1 && led.telemetry().is_some());
    let from = format!("board:{}", master.address);
    let faults = "seed=3,drop=5e-4,duplicate=1e-2,delay=30ms@0.1";
    let (leading, stdin) = Leading::start(&slave, &["--link-faults", faults, "--from", &from]);
    hand.until("the clutch closes", || leading.count(is_closed) == 1 && leading.telemetry().is_some());
    let (before, start) = (led.tool(), leading.tool());
    hand.move_to([0.0, 0.0, -0.03]);
    hand.until("both rest at the same displacement", || {
        let (master, tool) = (led.tool(), leading.tool());
        let difference: [f64; 3] =
            std::array::from_fn(|axis| (tool[axis] - start[axis]) - (master[axis] - before[axis]));
        distance(difference, [0.0; 3]) < 4e-3 && distance(tool, start) > 0.02
    });
    // Long enough that some frames are certainly lost.
    hand.until("enough telemetry", || leading.count(|value| value.get("sigma_min").is_some()) > 40);
    signal(&leading.child, Signal::SIGINT);
    let (code, values, error) = leading.finish();
    assert_eq!(code, 0, "{error}");
    let summary = values.last().unwrap();
    assert!(summary["samples"].as_u64().unwrap() > 100, "{summary}");
    assert!(summary["lost"].as_u64().unwrap() > 0, "{summary}");
    drop((stdin, hand));
    assert_eq!(led.finish().0, 0);
    slave.wait_for("disabled");
}

/// Waits until something has happened, while one arm leads the other.
#[track_caller]
fn wait(what: &str, mut has_happened: impl FnMut() -> bool) {
    let start = Instant::now();
    while !has_happened() {
        std::thread::sleep(Duration::from_millis(20));
        assert!(start.elapsed() < Duration::from_secs(60), "never: {what}");
    }
}

fn tip(server: &Server) -> [f64; 3] {
    numbers(&server.json(&["read"])["tips"]["hand"]["position"])
}

/// The links delay each message by up to 20 ms, and lose some; a person pulls the handle, and a wall blocks
/// only the slave.
#[test]
fn an_operator_feels_the_wall_before_the_slave() {
    // Stiffness of the person's arm, of the slave and of the wall [N/m]; motion and clearance [m].
    const PERSON: f64 = 500.0;
    const SLAVE: f64 = 300.0;
    const WALL: f64 = 5000.0;
    const WAY: f64 = 0.06;
    const CLEARANCE: f64 = 0.02;
    let (master, slave) = (arm(), arm());
    let (from, handle) = (format!("board:{}", master.address), file_of("handle"));
    let faults = "seed=3,drop=1e-4,delay=20ms@1";
    // Four messages of 10 ms on average; a busy machine would measure more.
    let options = ["--link-faults", faults, "--from", &from, "--reflect", &handle, "--round-trip", "0.04"];
    let (leading, stdin) = Leading::start_as(&slave, "soft", &options);
    wait("the clutch closes", || leading.count(|value| is_clutch(value, "closed", "")) == 1);
    wait("telemetry", || leading.telemetry().is_some());
    let (start, tool) = (tip(&master), leading.tool());

    // Free space: the slave reaches the position of the handle.
    master.make_trouble("pull 0.03 0 0");
    let moved = |leading: &Leading| leading.tool()[0] - tool[0];
    wait("both are there", || {
        let handle = tip(&master)[0] - start[0];
        handle > 0.025 && (moved(&leading) - handle).abs() < 4e-3
    });
    let begin = tip(&master)[0];

    slave.make_trouble(&format!("wall {CLEARANCE} 0 0 {WALL}"));
    master.make_trouble(&format!("pull {WAY} 0 0"));
    // Springs in series, by hand: 7.23 N; the friction of two arms at rest holds up to a fifth of it, either
    // way. A handle that feels nothing would let the slave press with 11.3 N.
    let expected = (WAY - CLEARANCE) / (1.0 / PERSON + 1.0 / SLAVE + 1.0 / WALL);
    let on_wall = |leading: &Leading| -numbers::<6>(&leading.telemetry().unwrap()["wrench"])[0];
    wait("the slave presses", || (on_wall(&leading) - expected).abs() < 0.2 * expected);
    std::thread::sleep(Duration::from_millis(1500));
    let mut forces = Vec::new();
    for _ in 0..10 {
        std::thread::sleep(Duration::from_millis(100));
        forces.push(on_wall(&leading));
    }
    let (low, high) = forces.iter().fold((f64::MAX, f64::MIN), |(low, high), f| (low.min(*f), high.max(*f)));
    assert!((expected * 0.75..expected * 1.25).contains(&low) && high - low < 1.0, "{forces:?}");
    let felt = PERSON * (begin + WAY - tip(&master)[0]);
    assert!((felt - low).abs() < 1.0, "{felt} N felt, {forces:?} N on the wall");

    master.make_trouble("pull off");
    wait("the spring pushes the handle back", || {
        leading.telemetry().is_some_and(|arm| arm["contact"] == false) && moved(&leading) < 0.055
    });
    signal(&leading.child, Signal::SIGINT);
    let (code, values, error) = leading.finish();
    assert_eq!(code, 0, "{error}");
    let reflected = &values.last().unwrap()["reflected"];
    let (largest, balance) = (&reflected["largest_force"], &reflected["energy_balance"]);
    assert!((expected * 0.75..expected * 1.6).contains(&largest.as_f64().unwrap()), "{reflected}");
    // The reserve of 20 mJ, and the energy of the first contact before it is known, which is more on a busy
    // machine.
    assert!(balance.as_f64().unwrap() > -0.06, "{reflected}");
    drop(stdin);
    for server in [&master, &slave] {
        server.wait_for("disabled");
        assert_eq!(server.json(&["faults"])["total"], 0);
    }
}

/// Both boards stop by themselves when they are no longer led, and settings without reflection are refused by
/// name.
#[test]
fn a_master_that_is_powered_never_stays_so_alone() {
    let (master, slave) = (arm(), arm());
    let (soft, handle, from) = (file_of("soft"), file_of("handle"), format!("board:{}", master.address));
    let refused = |arguments: &[&str], code: i32, words: &[&str]| {
        let mut all = vec!["follow", "--impedance", &soft];
        all.extend(arguments);
        slave.fails(&all, code, words);
    };
    refused(&["--reflect", &handle], 2, &["--reflect needs a master that is a board: --from board:ADDRESS"]);
    refused(&["--from", &from, "--reflect", "nowhere.toml"], 1, &["the master at", "nowhere.toml"]);
    let spoilt = slave.folder.path().join("spoilt.toml");
    let text = std::fs::read_to_string(&handle).unwrap();
    std::fs::write(
        &spoilt,
        text.replace("stiffness = { translation = 300.0", "stiffness = { translation = [300.0, 0.0, 300.0]"),
    )
    .unwrap();
    let spoilt = spoilt.to_str().unwrap();
    refused(
        &["--from", &from, "--reflect", spoilt],
        2,
        &["spoilt.toml: --reflect needs a stiffness above 0 along each"],
    );

    let untared = Server::ready_arm();
    let tare = format!("nothing touches the tool (`tesaki --port {} tare`)", untared.address);
    let to_untared = format!("board:{}", untared.address);
    refused(&["--from", &to_untared, "--reflect", &handle, "--round-trip", "0.01"], 7, &[&tare]);

    // By hand: 5 N·s/m for each of 2 kg plus 15 N·s/m of its own, divided by 300 N/m, minus half a period of
    // 10 ms, is 78.3 ms; 25 N·s/m divided by 235 ms is 106.4 N/m, and 300 N/m times 235 ms is 70.5 N·s/m.
    refused(
        &["--from", &from, "--reflect", &handle, "--round-trip", "0.2"],
        2,
        &[
            "comes back 230 ms after the motion, 200 ms of them stated on the links",
            "with the 300 N/m of",
            "calm up to 78.3 ms: at most 106 N/m there, 61 N·s/m of damping",
        ],
    );
    // Each message takes 40 ms on average, and a round trip consists of four messages.
    refused(
        &["--link-faults", "seed=3,delay=80ms@1", "--from", &from, "--reflect", &handle],
        2,
        &["ms of them measured on the links of master and slave", "calm up to 78.3 ms"],
    );
    // Measured on links without delay, unless the machine is busy.
    let brief = ["--from", &from, "--reflect", &handle, "--duration", "0.3", "--no-hold"];
    let brief = [&["follow", "--impedance", &soft], &brief[..]].concat();
    wait("quick links are accepted", || slave.run(&brief).0 == 0);
    [&master, &slave].into_iter().for_each(Server::wait_for_rest);

    let options = ["--from", from.as_str(), "--reflect", &handle, "--round-trip", "0.01"];
    // When the time is over the arm is held, and the master, which nobody leads any more, is disabled.
    let faults = || master.json(&["faults"])["total"].as_u64();
    let before = faults();
    let timed = [&["follow", "--hold", "--impedance", &soft, "--duration", "0.5"], &options[..]].concat();
    let mut child = slave.command(&timed).stdin(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    master.wait_for("enabled");
    master.wait_for("disabled");
    std::thread::sleep(Duration::from_millis(500));
    slave.wait_for("enabled");
    signal(&child, Signal::SIGINT);
    assert_eq!((child.wait().unwrap().code(), faults()), (Some(0), before));
    slave.wait_for("disabled");
    [&master, &slave].into_iter().for_each(Server::wait_for_rest);

    let (leading, stdin) = Leading::start_as(&slave, "soft", &options);
    wait("the clutch closes", || leading.count(|value| is_clutch(value, "closed", "")) == 1);
    master.wait_for("enabled");
    // The master's emergency stop: the program ends, and the slave holds or is off, as reported.
    master.make_trouble("estop on");
    let (code, _, error) = leading.finish();
    assert!(code == 1 && error.contains("its board is in fault"), "{code}: {error}");
    slave.wait_for("disabled");
    master.make_trouble("estop off");
    master.succeeds(&["faults", "--clear"]);
    drop(stdin);

    // The slave's: of the two boards its port is named.
    [&master, &slave].into_iter().for_each(Server::wait_for_rest);
    let (leading, stdin) = Leading::start_as(&slave, "soft", &options);
    wait("the clutch closes", || leading.count(|value| is_clutch(value, "closed", "")) == 1);
    slave.make_trouble("estop on");
    let (code, _, error) = leading.finish();
    let named = format!("{}: the board is in fault: ", slave.address);
    assert!(code == 5 && error.contains(&named), "{code}: {error}");
    master.wait_for("disabled");
    slave.make_trouble("estop off");
    slave.succeeds(&["faults", "--clear"]);
    drop(stdin);

    [&master, &slave].into_iter().for_each(Server::wait_for_rest);
    let (leading, stdin) = Leading::start_as(&slave, "soft", &options);
    wait("the clutch closes", || leading.count(|value| is_clutch(value, "closed", "")) == 1);
    master.wait_for("enabled");
    signal(&leading.child, Signal::SIGKILL);
    for server in [&master, &slave] {
        server.wait_for("in fault");
        let faults = server.succeeds(&["faults"]);
        assert!(faults.contains("command timeout") || faults.contains("no command"), "{faults}");
    }
    drop((leading.finish(), stdin));
}
