use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;

use super::*;

fn joint(name: &str, position: f32) -> JointView {
    JointView {
        name: name.to_owned(),
        position,
        velocity: 0.125,
        reference: 0.5,
        lower: 0.0,
        upper: 1.5,
        torque: 0.15,
        torque_limit: 0.3,
        homed: true,
        history: (0_u8..100).map(|index| f32::from(index) / 100.0).collect(),
    }
}

fn view(joints: Vec<JointView>) -> View {
    View {
        title: "hand3 on /dev/ttyUSB0, firmware 0.1.0".to_owned(),
        mode: "armed (joint servo, observer)".to_owned(),
        state: State::Armed,
        time: 3_723.4,
        joints,
        faults: Vec::new(),
        link: LinkView {
            open: true,
            rate: 99.0,
            expected_rate: 100.0,
            lost: 0,
            damaged: 0,
            round_trip_ms: Some(1.8),
            last_seconds: 0.0,
        },
        supply: Some(12.04),
        hint: "space stops".to_owned(),
    }
}

fn hand() -> View {
    let names = ["thumb", "index", "middle"];
    let mut joints = Vec::new();
    for (finger, name) in (0_u8..).zip(names) {
        for (knuckle, part) in (0_u8..).zip(["abduct", "mcp", "pip"]) {
            let mut joint = joint(&format!("{name}_{part}"), 0.0);
            let phase = f64::from(finger) + 0.6 * f64::from(knuckle);
            (joint.lower, joint.upper) = if knuckle == 0 { (-0.35, 0.35) } else { (-0.1, 1.6) };
            let (middle, reach) = if knuckle == 0 { (0.0, 0.2) } else { (0.7, 0.5) };
            joint.history.clear();
            for index in 0..240_u16 {
                #[expect(clippy::cast_possible_truncation)]
                joint.remember((middle + reach * (phase + f64::from(index) / 30.0).sin()) as f32);
            }
            joint.reference = joint.position + 0.13;
            joint.torque = 0.28 * (f32::from(knuckle) - 0.8) * (f32::from(finger) - 0.7);
            joints.push(joint);
        }
    }
    joints[4].remember(1.58);
    joints[7].remember(1.72);
    joints[7].torque = 0.33;
    joints[8].homed = false;
    let mut view = view(joints);
    view.faults =
        vec!["middle_mcp: position beyond its limit".into(), "supply was below 10.5 V for 12 ms".into()];
    view.hint = "faults unread: press f".into();
    view
}

fn buffer(width: u16, height: u16, paint: impl FnOnce(&mut ratatui::Frame)) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(paint).unwrap();
    terminal.backend().buffer().clone()
}

fn lines(buffer: &Buffer) -> Vec<String> {
    let row = |y| (0..buffer.area.width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
    (0..buffer.area.height).map(row).map(|line| line.trim_end().to_owned()).collect()
}

fn text(width: u16, height: u16, view: &View, selected: Option<usize>) -> Vec<String> {
    lines(&buffer(width, height, |frame| draw(frame, view, selected)))
}

/// Writes what is drawn for a look at it: `TESAKI_MONITOR_DUMP=folder cargo test`.
fn dump(name: &str, buffer: &Buffer) {
    let Some(folder) = std::env::var_os("TESAKI_MONITOR_DUMP") else { return };
    let mut text = String::new();
    for y in 0..buffer.area.height {
        for x in 0..buffer.area.width {
            let cell = &buffer[(x, y)];
            text += &format!("{x}\t{y}\t{}\t{:?}\t{:?}\n", cell.symbol(), cell.fg, cell.modifier);
        }
    }
    std::fs::write(std::path::Path::new(&folder).join(name), text).unwrap();
}

#[test]
fn pictures() {
    let mut sixteen =
        view((0_u8..16).map(|index| joint(&format!("joint_{index}"), f32::from(index) / 9.0)).collect());
    sixteen.faults = hand().faults;
    let pictures =
        [(100, 30, hand()), (80, 24, hand()), (160, 40, hand()), (60, 12, hand()), (80, 24, sixteen)];
    for (index, (width, height, view)) in (0_u8..).zip(pictures) {
        let shown = buffer(width, height, |frame| draw(frame, &view, Some(3)));
        dump(&format!("{index}-{width}x{height}.tsv"), &shown);
    }
    dump(
        "help.tsv",
        &buffer(80, 24, |frame| {
            draw(frame, &hand(), None);
            draw_help(frame);
        }),
    );
    dump(
        "faults.tsv",
        &buffer(80, 24, |frame| {
            draw(frame, &hand(), None);
            draw_faults(frame, &hand());
        }),
    );
}
