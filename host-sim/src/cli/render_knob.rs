//! `host-sim render-knob`.

use std::error::Error;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::Args;
use tesaki_output::say;
use tesaki_sim::camera::{Camera, CameraValues, ImageTruth, Optics, Scene, View};
use tesaki_sim::report::create;

use super::{of_file, seeds, workspace};

#[derive(Args)]
pub struct RenderKnob {
    /// Seed of door, knob, light, camera errors and place of the hand; a range such as 1-8 renders all of
    /// them
    #[arg(long, default_value = "1", value_parser = seeds, allow_hyphen_values = true)]
    seed: RangeInclusive<u64>,
    /// Folder for the pictures
    #[arg(long, default_value_os_t = PathBuf::from("out/render-knob"))]
    out: PathBuf,
    /// Robot folder with camera.toml
    #[arg(long, default_value_os_t = workspace().join("robots/knob-arm"))]
    robot: PathBuf,
    /// Distance from the fingertips to the door [m]; default: 0.06 to 0.25, by the seed
    #[arg(long, allow_negative_numbers = true)]
    distance: Option<f64>,
    /// Pictures of each door from so many places, turned as the calibration of the camera needs it; also
    /// writes knob-SEED.csv with the pose of the hand in the frame of the door
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    views: Option<u32>,
    /// In place of knob and rose a black disc on white paper, 40 mm in radius
    #[arg(long)]
    disc: bool,
    /// Without blur, noise and vignetting
    #[arg(long)]
    ideal: bool,
}

/// What `render-knob` prints about a picture.
#[derive(serde::Serialize)]
struct RenderedKnob {
    seed: u64,
    file: PathBuf,
    /// Of the hand in the door frame: x, y, z [m], and quaternion x, y, z, w.
    hand: ([f64; 3], [f64; 4]),
    rose_radius: f64,
    #[serde(flatten)]
    truth: ImageTruth,
}

pub fn run(options: &RenderKnob) -> Result<(), Box<dyn Error>> {
    let values = CameraValues::load(&options.robot)?;
    if let Some(distance) = options.distance.filter(|distance| !(0.01..=1.0).contains(distance)) {
        return Err(format!("--distance is {distance} m: it must be from 0.01 to 1 m").into());
    }
    create(&options.out)?;
    let place = |mut view: View| {
        if let Some(distance) = options.distance {
            view.hand.translation.z = -distance;
        }
        view
    };
    for seed in options.seed.clone() {
        let door = Door {
            seed,
            scene: if options.disc { Scene::draw(seed).with_disc() } else { Scene::draw(seed) },
            optics: if options.ideal { Optics::ideal(0.3) } else { Optics::draw(seed) },
            values,
            out: &options.out,
        };
        let Some(views) = options.views else {
            door.photograph(&place(View::draw(seed)), 0, format!("knob-{seed}.png"))?;
            continue;
        };
        let mut table = format!("{VIEW_COLUMNS}\n");
        let mut numbers = 0..;
        for number in 1..=views {
            // From some places too little of the rose is seen.
            let places =
                numbers.by_ref().take(MAX_PLACES).map(|number| place(View::for_calibration(seed, number)));
            let view = { places }.find(|view| door.shows_enough(view)).ok_or_else(|| {
                format!(
                    "from none of {MAX_PLACES} places the camera sees {:.0} % of the rose",
                    100.0 * ENOUGH
                )
            })?;
            table += &door.photograph(&view, number, format!("knob-{seed}-{number:02}.png"))?;
            table.push('\n');
        }
        let file = options.out.join(format!("knob-{seed}.csv"));
        std::fs::write(&file, table).map_err(of_file(&file))?;
    }
    Ok(())
}

/// Columns of the table of `--views`.
const VIEW_COLUMNS: &str = "image,x,y,z,qx,qy,qz,qw,distance,true_u,true_v,true_radius";
/// Share of the rim of the rose that a picture of `--views` shows at least.
const ENOUGH: f64 = 0.6;
/// Places that are tried for a picture.
const MAX_PLACES: usize = 1000;

/// A door before which pictures are taken.
struct Door<'a> {
    seed: u64,
    scene: Scene,
    optics: Optics,
    values: CameraValues,
    out: &'a Path,
}

impl Door<'_> {
    /// Angle of the open fingers of the gripper [rad].
    const OPEN: f64 = 0.22;

    fn truth(&self, view: &View) -> ImageTruth {
        let pose = view.hand * self.values.mount();
        self.scene.truth(&Camera::of(&self.values), &pose, &view.fingers(Self::OPEN))
    }

    fn shows_enough(&self, view: &View) -> bool {
        self.truth(view).rose.is_some_and(|rose| rose.visible >= ENOUGH)
    }

    /// Writes a picture, and prints what is true of it. Returns its row of the table.
    fn photograph(&self, view: &View, number: u32, name: String) -> Result<String, Box<dyn Error>> {
        let (pose, fingers) = (view.hand * self.values.mount(), view.fingers(Self::OPEN));
        let noise = (self.seed, number);
        let image = self.scene.photograph(&Camera::of(&self.values), &self.optics, &pose, &fingers, noise);
        let file = self.out.join(&name);
        std::fs::write(&file, image.png()?).map_err(of_file(&file))?;
        let (place, turn): ([f64; 3], [f64; 4]) =
            (view.hand.translation.vector.into(), view.hand.rotation.coords.into());
        let truth = self.truth(view);
        let mut row = vec![name];
        row.extend(place.iter().chain(&turn).map(f64::to_string));
        // As somebody measures it: from the lens to the door.
        row.push(format!("{:.2}", -pose.translation.z));
        row.extend(match &truth.rose {
            Some(rose) => [rose.center[0], rose.center[1], rose.radius].map(|value| value.to_string()),
            None => Default::default(),
        });
        let rose_radius = self.scene.rose.radius;
        let rendered = RenderedKnob { seed: self.seed, file, hand: (place, turn), rose_radius, truth };
        say!("{}", serde_json::to_string(&rendered)?);
        Ok(row.join(","))
    }
}
