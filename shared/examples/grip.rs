//! The least grip of every grasp in a file, for `tests/oracles/grip.py`: `cargo run --release -p tesaki
//! --example grip -- FILE`. Prints `index,held|refused|unsolved,steps,rest,` and the forces, or the
//! certificate's twist.

use nalgebra::{Vector3, Vector6};
use tesaki::grasp::{Contact, GraspMap, GripError, GripState, LeastGrip};

fn answer(line: &str) -> Result<String, Box<dyn std::error::Error>> {
    let values: Vec<f32> = line.split(',').map(|value| value.parse().unwrap_or(f32::NAN)).collect();
    let [_, count, margin, least, rest @ ..] = &values[..] else { return Err("too few values".into()) };
    let (load, rest) = rest.split_first_chunk::<6>().ok_or("no load")?;
    let mut contacts = Vec::new();
    for of in rest.chunks_exact(8) {
        let &[x, y, z, nx, ny, nz, friction, limit] = of else { continue };
        let (position, normal) = (Vector3::new(x, y, z), Vector3::new(nx, ny, nz));
        #[expect(clippy::cast_precision_loss, reason = "2 to 6")]
        if (contacts.len() as f32) < *count {
            contacts.push(Contact::try_new(position, normal, friction, limit)?);
        }
    }
    let map = GraspMap::try_new(&contacts, Vector3::zeros())?;
    let grip = LeastGrip::try_new(*margin, *least)?;
    let load = Vector6::from(*load);
    let list = |values: &mut dyn Iterator<Item = f32>| -> String {
        values.map(|value| format!(",{value}")).collect()
    };
    Ok(match grip.solve(&map, &load, &mut GripState::default()) {
        Ok(grip) => {
            let forces = list(&mut grip.forces.iter().flat_map(|force| [force.x, force.y, force.z]));
            format!("held,{},{}{forces}", grip.steps, grip.residual)
        }
        Err(GripError::CannotHold(certificate)) => {
            format!("refused,0,0{}", list(&mut certificate.twist.iter().copied()))
        }
        Err(GripError::NotConverged { residual }) => format!("unsolved,0,{residual}"),
        Err(other) => return Err(other.into()),
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("usage: grip FILE")?;
    for (index, line) in std::fs::read_to_string(path)?.lines().enumerate() {
        println!("{index},{}", answer(line)?);
    }
    Ok(())
}
