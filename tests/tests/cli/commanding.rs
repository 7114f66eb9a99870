//! Command of a board, and what happens when the commander leaves.

use super::server::{Server, finish, said, signal};

#[test]
fn ctrl_c_disables_a_second_commander_is_refused_and_anyone_may_stop() {
    let server = Server::ready();
    let mut first = server.start_command(&["enable"]);
    server.wait_for("enabled");
    server.fails(&["enable"], 7, &["another client"]);
    server.fails(&["--take-over", "enable"], 7, &["another client"]);
    signal(&first, nix::sys::signal::Signal::SIGINT);
    assert!(first.wait().unwrap().success());
    assert!(server.succeeds(&["info"]).contains("mode           disabled"));

    let second = server.start_command(&["enable"]);
    server.wait_for("enabled");
    assert!(server.succeeds(&["stop"]).contains("stopped"));
    let (code, text) = said(&finish(second));
    assert_eq!(code, 5, "{text}");
    assert!(text.contains("fault 17") && text.contains("tesaki faults --clear"), "{text}");
    server.fails(&["move", "finger1_swing=0"], 5, &["fault 17"]);
    server.fails(&["doctor"], 5, &["in fault", "tesaki faults --clear"]);
    assert!(server.succeeds(&["faults", "--clear"]).contains("disabled"));
    server.succeeds(&["move", "finger1_swing=0.05"]);
}

#[test]
fn a_supervisor_that_dies_leaves_a_board_that_stops_by_itself_and_serves_the_next_one() {
    let server = Server::ready();
    let mut victim = server.start_command(&["enable"]);
    server.wait_for("enabled");
    victim.kill().unwrap();
    victim.wait().unwrap();
    server.wait_for("in fault");
    server.fails(&["move", "finger1_swing=0"], 5, &["fault 0", "limit 1 s"]);
    server.succeeds(&["faults", "--clear"]);
    server.succeeds(&["move", "finger1_swing=0.05"]);
}
