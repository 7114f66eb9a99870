//! `host-sim serve`.

use std::error::Error;
use std::path::{Path, PathBuf};

use clap::Args;
use tesaki::model::RobotModel;
use tesaki_description::finding::Finding;
use tesaki_description::robot::RobotFolder;
use tesaki_description::{FileError, read_text};
use tesaki_output::{note, quoted, say};
use tesaki_sim::plant::{Plant, PlantOptions};
use tesaki_sim::qemu::{Machine, Qemu};
use tesaki_sim::scenario::scene::around_object;
use tesaki_sim::serve::{ServedBoard, home_command, input_lines, serve};
use tesaki_sim::serve_folder;
use tesaki_sim::served_camera::{ServedCamera, ServedDoor};
use tesaki_sim::virtual_board::VirtualBoard;
use tesaki_supervisor::hub::Hub;
use tesaki_supervisor::port::{Address, Announcement, Key};

use super::{ControllerKind, default_image, interrupt, of_file, shown, workspace};

#[derive(Args)]
pub struct Serve {
    /// Robot folder
    #[arg(long, default_value_os_t = workspace().join("robots/hand3"))]
    robot: PathBuf,
    /// Where the control core runs
    #[arg(long, value_enum, default_value_t = ControllerKind::Native)]
    controller: ControllerKind,
    /// Address for clients: unix://PATH or tcp://HOST:PORT; default: a new Unix socket
    #[arg(long, value_parser = Address::socket)]
    listen: Option<Address>,
    /// Key file for a TCP address that other machines reach; `tesaki key FILE` makes one
    #[arg(long, env = "TESAKI_KEY", value_name = "FILE")]
    key: Option<PathBuf>,
    /// Seed of the machine's deviations and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Start with the fingers open around the object of this grasp, for example robots/hand3/grasps/box.toml
    #[arg(long)]
    grasp: Option<PathBuf>,
    /// Object on a support at the pose that `--grasp` expects, for example robots/hand3/objects/box.toml
    #[arg(long, requires = "grasp")]
    object: Option<PathBuf>,
    /// Put the arm before a door with this seed: of its surfaces, its light, and of where it is. The robot
    /// needs camera.toml and approach.toml; the camera in its hand takes ten pictures a second
    #[arg(long, value_name = "SEED", conflicts_with = "grasp")]
    door: Option<u64>,
    /// Radius of the rose of that door [m]; default: 0.035 to 0.045, by the seed
    #[arg(long, value_name = "RADIUS", requires = "door", allow_negative_numbers = true)]
    rose: Option<f64>,
    /// Address for programs that receive the pictures: unix://PATH or tcp://localhost:PORT; default: a new
    /// Unix socket
    #[arg(
        long, value_name = "ADDRESS", requires = "door", value_parser = Address::socket
    )]
    camera: Option<Address>,
    /// Firmware image for `--controller qemu`
    #[arg(long, env = "TESAKI_ELF", default_value_os_t = default_image())]
    elf: PathBuf,
}

pub fn run(options: &Serve) -> Result<(), Box<dyn Error>> {
    interrupt::handle()?;
    let (robot, warnings) = load_all(&options.robot)?;
    let name = robot.model.name.as_str();
    let mut machine = PlantOptions::mismatched(options.seed);
    if let Some(grasp) = &options.grasp {
        machine = around_object(machine, &robot.model, grasp, options.object.as_deref())?;
    }
    let mut plant = Plant::of(&robot, &machine)?;
    let (mut native, mut qemu);
    let board: &mut dyn ServedBoard = match options.controller {
        ControllerKind::Native => {
            native = VirtualBoard::default();
            &mut native
        }
        ControllerKind::Qemu => {
            qemu = Qemu::boot(&options.elf, &Machine { own_group: true, ..Machine::default() })?;
            &mut qemu
        }
    };
    let (folder, _lock) = serve_folder::create()?;
    let mut camera = None;
    if let Some(door) = served_door(options, &robot, &plant)? {
        let default = || Address::Unix(folder.path().join("camera"));
        let address = options.camera.clone().unwrap_or_else(default);
        let (before_door, pictures) = door.serve(&robot, &machine, &address)?;
        (plant, camera) = (before_door, Some(pictures));
    }
    let listen = options.listen.clone().unwrap_or_else(|| Address::Unix(folder.path().join("board")));
    let key = options.key.as_ref().map(|path| Key::read(path).map_err(of_file(path)));
    let mut hub = Hub::listen(&listen, key.transpose()?.as_ref())?;
    let terminal = hub.add_pty()?;
    let kind = match options.controller {
        ControllerKind::Native => "simulated",
        ControllerKind::Qemu => "simulated, its firmware in QEMU",
    };
    let _announcement = Announcement::new(name, hub.address(), &format!("{name}, {kind}"))?;
    say!(
        "{name}, {kind}, seed {}: a board without a model, as after power-on.\n\
         \x20 socket           {} (found by `--port auto`; can be shared by several programs)\n\
         \x20 pseudo-terminal  {} (like a serial port)\n{}\n\
         In another terminal, with `alias tesaki='cargo tesaki'`:\n\
         \x20 tesaki doctor\n\
         \x20 tesaki model push {}\n\
         {}\x20 {}\n\n\
         Ctrl-C stops; `help` lists the faults that can be injected here.",
        options.seed,
        hub.address(),
        terminal.display(),
        camera.as_ref().map_or_else(String::new, |camera| format!(
            "\x20 camera           {} (pictures of the door, for `tesaki look`)\n",
            camera.address()
        )),
        quoted_path(&options.robot),
        home_command(&plant, &robot.model).map_or_else(String::new, |home| format!("  {home}\n")),
        example_command(options, &robot.model, camera.as_ref()),
    );
    for warning in warnings {
        note!("warning: {warning}");
    }
    let lines = input_lines();
    serve(&mut hub, board, &mut plant, &robot.model, camera.as_ref(), &lines, &interrupt::asked)?;
    Ok(())
}

/// Reads and checks the robot folder with its `plant.toml`, as `tesaki model check` does; with its warnings.
fn load_all(path: &Path) -> Result<(RobotFolder, Vec<Finding>), Box<dyn Error>> {
    let file = path.join("plant.toml");
    let advice =
        "it holds what is simulated; `tesaki model init` writes one, docs/bring-your-own-hand.md has another";
    let plant = read_text(&file).map_err(FileError::unread(&file, advice))?;
    Ok(RobotFolder::load_plausible(path, Some(&plant))?)
}

/// What `--door` asks for.
fn served_door(
    options: &Serve,
    robot: &RobotFolder,
    plant: &Plant,
) -> Result<Option<ServedDoor>, Box<dyn Error>> {
    let Some(seed) = options.door else { return Ok(None) };
    if let (Some(listen), Some(camera)) = (&options.listen, &options.camera)
        && listen == camera
    {
        return Err(format!(
            "--listen and --camera are both {camera}: the pictures need an address of their own"
        )
        .into());
    }
    let mut served = ServedDoor::draw(robot, plant, seed)?;
    if let Some(radius) = options.rose {
        let scene = &mut served.door.scene;
        let range = scene.knob.radius + 0.005..=0.1;
        if !range.contains(&radius) {
            let [from, to] = [range.start(), range.end()];
            return Err(format!("--rose is {radius} m: it must be from {from:.3} to {to} m").into());
        }
        scene.rose.radius = radius;
    }
    Ok(Some(served))
}

/// The path relative to the current folder, for a shell.
fn quoted_path(path: &Path) -> String {
    quoted(&shown(path).display().to_string())
}

/// What to try on the machine once it is homed.
fn example_command(options: &Serve, model: &RobotModel, camera: Option<&ServedCamera>) -> String {
    if let Some(camera) = camera {
        return format!(
            "tesaki look --from {} --to unix://circles\n\
             and in a third one:\n\
             \x20 tesaki approach --robot {} --from unix://circles",
            camera.address(),
            quoted_path(&options.robot)
        );
    }
    let impedance = options.robot.join("impedances/soft.toml");
    if impedance.is_file() {
        return format!("tesaki tare\n  tesaki impedance hold {}", quoted_path(&impedance));
    }
    match &options.grasp {
        Some(path) => format!("tesaki tare\n  tesaki grasp run {} lift=0.01 hold=5", quoted_path(path)),
        None => format!("tesaki move {}", quoted(&format!("{}=0.3", model.joint_name(0)))),
    }
}
