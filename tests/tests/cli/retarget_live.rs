//! `tesaki retarget --live`: an operator's fingertips lead the five-finger hand on a board.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::UdpSocket;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tesaki::teleop::HumanFinger;
use tesaki_rng::Rng;
use tesaki_sim::plant::PlantOptions;

use super::retarget::{TIPS, json_lines, rows};
use super::server::{Server, finish, said, signal};

/// Starts the five-finger hand on a board, ready to be enabled.
fn board() -> Server {
    let hand5 = tesaki_tests::robot_folder("hand5");
    let options = PlantOptions::mismatched(1);
    let server = Server::start_robot(&hand5, tempfile::tempdir().unwrap(), &options);
    server.succeeds(&["model", "push", hand5.to_str().unwrap()]);
    server.home();
    server
}

fn follow(server: &Server, arguments: &[&str]) -> Child {
    let mut command = server.command(&["--json", "retarget", "--live", "--no-hold", "--bandwidth", "10"]);
    command.args(arguments).arg("--robot").arg(tesaki_tests::robot_folder("hand5"));
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Sends the robot's posture at 60 Hz until the board is enabled, then the motion to and fro for some
/// seconds, then holds still for half a second; a sixth of the lines is lost. Each line carries its sending
/// time: a busy machine sends fewer, but none too late. Returns the number of lines sent.
fn stream(server: &Server, seconds: f64, mut send: impl FnMut(String)) -> u32 {
    let tips = rows(TIPS);
    let (begin, mut rng, mut sent) = (Instant::now(), Rng::new(5, 0), 0);
    let mut enabled = None::<Instant>;
    std::thread::scope(|scope| {
        let enabling = scope.spawn(|| server.wait_for("enabled"));
        loop {
            if enabled.is_none() && enabling.is_finished() {
                enabled = Some(Instant::now());
            }
            let moving = enabled.map_or(0.0, |enabled| enabled.elapsed().as_secs_f64());
            if moving > seconds + 0.5 {
                break;
            }
            // A third of the file's speed, starting from its posture.
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a row")]
            let place = (20.0 * seconds.min(moving)) as usize % tips.len();
            let mut line = json!({ "time": begin.elapsed().as_secs_f64(), "tips": {} });
            for (finger, tip) in HumanFinger::ALL.into_iter().zip(tips[place].chunks(3)) {
                line["tips"][finger.name()] = json!(tip);
            }
            if rng.uniform() > 0.17 {
                send(format!("{line}\n"));
                sent += 1;
            }
            std::thread::sleep(Duration::from_micros(16_667));
        }
    });
    sent
}

/// Returns the angles of all joints from the board.
fn angles(server: &Server) -> Vec<f64> {
    let state = server.json(&["read"]);
    state["joints"].as_array().unwrap().iter().map(|joint| joint["position"].as_f64().unwrap()).collect()
}

#[test]
fn a_stream_with_losses_leads_the_hand_on_a_board() {
    let server = board();
    let before = angles(&server);
    let mut child = follow(&server, &[]);
    let mut stdin = child.stdin.take().unwrap();
    // Single frames that cannot belong to a hand are dropped.
    let mut count = 0;
    let sent = stream(&server, 3.0, |line| {
        count += 1;
        if count % 50 == 0 {
            stdin.write_all(b"{\"time\": 1000, \"tips\": {\"thumb\": [90, 0, 0]}}\n").unwrap();
        }
        stdin.write_all(line.as_bytes()).unwrap();
    });
    drop(stdin);
    let (code, out) = said(&finish(child));
    assert_eq!(code, 0, "{out}");
    let objects: Vec<Value> = out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let (last, reports) = objects.split_last().unwrap();
    assert_eq!((&last["frames"], &last["dropped"]), (&json!(sent), &json!(count / 50)), "{out}");
    // Each sample lasts for at least one tick; a busy machine sends only the newest.
    let samples = |report: &Value| report["samples"].as_u64().unwrap();
    assert!(reports.iter().all(|report| report["ignored"] == 0), "{out}");
    assert!(
        reports.iter().any(|report| samples(report) > 10 && report["missed"] == 0 && report["unknown"] == 0),
        "{out}"
    );
    let moved =
        angles(&server).iter().zip(before).map(|(now, before)| (now - before).abs()).fold(0.0, f64::max);
    assert!(moved > 0.05, "{moved} rad");
    assert!(server.succeeds(&["info"]).contains("mode           disabled"));
}

#[test]
fn settings_that_are_no_robots_are_told_live_too() {
    let server = board();
    let folder = tempfile::tempdir().unwrap();
    let without = ["without --robot DIR, whose retargeting.toml is read, defaults are used"];
    server.fails(&["retarget", "--live"], 1, &without);
    let live = ["retarget", "--live", "--robot", folder.path().to_str().unwrap()];
    server.fails(&live, 1, &["retargeting.toml: there is none, so defaults are used"]);
    let other = tesaki_tests::robot_folder("hand3");
    let other = ["retarget", "--live", "--robot", other.to_str().unwrap()];
    server.fails(&other, 2, &["the board is hand5, and --robot is the folder of hand3"]);
}

#[test]
fn a_source_that_goes_wrong_stops_the_hand_and_is_told() {
    let server = board();
    // Datagrams are not protected by a key: only this machine may send them.
    for address in ["0.0.0.0:7500", "[::]:7500", "192.0.2.1:7500"] {
        let words = ["is reachable from other machines", "tunnel"];
        server.fails(&["retarget", "--live", "--udp", address], 2, &words);
    }
    server.fails(&["retarget", "--live", "--udp", "0"], 2, &["port 0 is none"]);
    server.fails(&["retarget", "--live", "--udp", "hand"], 2, &["expected PORT or 127.0.0.1:PORT"]);
    // Valid at first, then all in millimetres.
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let child = follow(&server, &["--udp", &port.to_string()]);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let good = json_lines(|_, tip| tip);
    let bad = json_lines(|_, tip| tip.map(|x| 1e3 * x));
    let begin = Instant::now();
    let send = |line: &str| {
        let mut value: Value = serde_json::from_str(line).unwrap();
        value["time"] = json!(begin.elapsed().as_secs_f64());
        // Before the program runs, nobody listens.
        let _ = socket.send_to(value.to_string().as_bytes(), ("127.0.0.1", port));
        std::thread::sleep(Duration::from_millis(20));
    };
    let first = good.lines().next().unwrap();
    let mut is_enabled = false;
    while !is_enabled {
        (0..20).for_each(|_| send(first));
        is_enabled = server.succeeds(&["info"]).contains("mode           enabled");
        assert!(is_enabled || begin.elapsed() < Duration::from_secs(60));
    }
    bad.lines().cycle().take(60).for_each(send);
    let (code, out) = said(&finish(child));
    assert!(code == 1 && out.contains("sends no valid frame any more; the last error: "), "{code}: {out}");
    assert!(out.contains("would have this in mm") && out.contains("the board is disabled"), "{out}");

    // Silence, and Ctrl-C while the source is silent.
    server.wait_for_rest();
    let mut child = follow(&server, &["--silence", "0.5"]);
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(format!("{first}\n").as_bytes()).unwrap();
    let (code, out) = said(&finish(child));
    assert!(code == 6 && out.contains("has sent nothing for 0.5 s"), "{code}: {out}");
    drop(stdin);
    server.wait_for_rest();
    let mut child = follow(&server, &["--silence", "60"]);
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(format!("{first}\n").as_bytes()).unwrap();
    let child = server.wait_with(child, "enabled");
    signal(&child, nix::sys::signal::Signal::SIGINT);
    let (code, out) = said(&finish(child));
    assert_eq!(code, 0, "{out}");
    server.wait_for("disabled");
    // A silent source, then frames without the thumb: the program reports what is missing.
    server.wait_for_rest();
    let mut command = server.command(&["retarget", "--live", "--silence", "1"]);
    let mut child = command.stdin(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let mut told = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(told.any(|line| line.contains("nothing has come from standard input yet")));
    let writer = std::thread::spawn(move || {
        // Until the reader has gone.
        while let line = json!({ "time": begin.elapsed().as_secs_f64(), "tips": {} })
            && stdin.write_all(format!("{line}\n").as_bytes()).is_ok()
        {
            std::thread::sleep(Duration::from_millis(20));
        }
    });
    assert!(told.any(|line| line.contains("none shows the thumb")));
    signal(&child, nix::sys::signal::Signal::SIGINT);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    writer.join().unwrap();
    // A source without a valid frame enables nothing.
    let mut child = follow(&server, &[]);
    child.stdin.take().unwrap().write_all(b"{\"time\": 0}\n").unwrap();
    let (code, out) = said(&finish(child));
    assert!(code == 1 && out.contains("line 1: none of") && out.contains("nothing was enabled"), "{out}");
    let mut child = follow(&server, &[]);
    child.stdin.take().unwrap().write_all(TIPS.as_bytes()).unwrap();
    let (code, out) = said(&finish(child));
    assert!(
        code == 1 && out.contains("this looks like CSV") && out.contains("--in FILE, without --live"),
        "{out}"
    );
}

/// Stray lines of another kind at the start, and with a time far ahead, are tolerated; after several faults
/// the first one is reported.
#[test]
fn a_stray_line_does_not_lock_the_source_and_the_first_fault_is_told() {
    let server = board();
    let mut child = follow(&server, &[]);
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(b"{\"time\": 1e6, \"landmarks\": null}\n").unwrap();
    let mut count = 0;
    let sent = stream(&server, 1.0, |line| {
        count += 1;
        if count == 40 {
            // All is right with it but its time.
            let mut value: Value = serde_json::from_str(&line).unwrap();
            value["time"] = json!(1000.0 + value["time"].as_f64().unwrap());
            stdin.write_all(format!("{value}\n").as_bytes()).unwrap();
        }
        stdin.write_all(line.as_bytes()).unwrap();
    });
    drop(stdin);
    let (code, out) = said(&finish(child));
    assert_eq!(code, 0, "{out}");
    assert!(count > 40, "{count}");
    let last: Value = serde_json::from_str(out.lines().last().unwrap()).unwrap();
    assert_eq!((&last["frames"], &last["dropped"]), (&json!(sent), &json!(2)), "{out}");

    server.wait_for_rest();
    let mut child = follow(&server, &["--silence", "60"]);
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(json_lines(|_, tip| tip).lines().next().unwrap().as_bytes()).unwrap();
    stdin.write_all(b"\n").unwrap();
    let child = server.wait_with(child, "enabled");
    // The stopped program learns of both faults at once.
    signal(&child, nix::sys::signal::Signal::SIGSTOP);
    server.make_trouble("supply 15");
    server.wait_for("in fault");
    server.make_trouble("estop on");
    server.wait_for_faults(2);
    signal(&child, nix::sys::signal::Signal::SIGCONT);
    let (code, out) = said(&finish(child));
    assert!(code == 5 && out.contains("supply voltage too low"), "{code}: {out}");
    assert!(out.contains("Then 1 fault"), "{out}");
}
