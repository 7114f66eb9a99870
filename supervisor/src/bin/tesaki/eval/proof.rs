//! Certificates, checked anew in double precision and without the core's own code.

use nalgebra::{Vector3, Vector6};

use super::contacts::Grasp;
use crate::args::Grip;

/// Whether the load has more power against `twist`, about the contacts' centroid, than any forces inside
/// their cones and limits have: then none of them hold it.
pub fn holds(asked: &Grip, grasp: &Grasp, twist: &Vector6<f32>) -> bool {
    let halves = |six: &Vector6<f32>| {
        let six = six.cast::<f64>();
        (Vector3::new(six.x, six.y, six.z), Vector3::new(six.w, six.a, six.b))
    };
    let (linear, angular) = halves(twist);
    let (force, moment) = halves(&grasp.load);
    let contacts = grasp.map.contacts();
    let places: Vec<Vector3<f64>> = contacts.iter().map(|contact| contact.position().cast()).collect();
    #[expect(clippy::cast_precision_loss, reason = "2 to 6")]
    let center = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
    let arm = center - grasp.map.origin().cast::<f64>();
    let power = linear.dot(&force) + angular.dot(&(moment - arm.cross(&force)));
    let most = contacts.iter().zip(&places).map(|(contact, place)| {
        let velocity = linear + angular.cross(&(place - center));
        let normal = contact.normal().cast::<f64>().normalize();
        let along = normal.dot(&velocity);
        let friction = f64::from(contact.friction()) * (1.0 - f64::from(asked.margin));
        // The power of the best force for each newton along the normal.
        let rate = along + friction * (velocity - normal * along).norm();
        rate * f64::from(if rate > 0.0 { contact.limit() } else { asked.min })
    });
    power > most.sum::<f64>()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use tesaki::grasp::{Contact, GraspMap};

    use super::*;

    #[test]
    fn only_a_twist_against_a_load_too_heavy_is_a_proof() {
        // Two fingers that carry 2 · 0.5 · (1 − margin) · 20 N upwards.
        let finger = |side: f32| {
            let normal = Vector3::new(-side, 0.0, 0.0);
            Contact::try_new(Vector3::new(0.02 * side, 0.0, 0.1), normal, 0.5, 20.0).unwrap()
        };
        let map = GraspMap::try_new(&[finger(-1.0), finger(1.0)], Vector3::new(0.5, 0.0, 0.0)).unwrap();
        let proves = |twist: [f32; 6], weight: f32, margin: f32| {
            let asked =
                Grip { input: "-".into(), output: "-".into(), margin, min: 0.0, friction: None, max: None };
            // The weight hangs between the fingers, half a metre from the origin.
            let load = Vector6::new(0.0, 0.0, weight, 0.0, 0.5 * weight, 0.0);
            let grasp = Grasp { map: map.clone(), load, numbers: vec![1, 2] };
            holds(&asked, &grasp, &Vector6::from(twist))
        };
        let up = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
        assert!(proves(up, 20.001, 0.0) && !proves(up, 19.999, 0.0));
        assert!(proves(up, 16.001, 0.2) && !proves(up, 15.999, 0.2));
        assert!(!proves(up.map(|value| -value), 30.0, 0.0));
        assert!(!proves([0.0; 6], 30.0, 0.0) && !proves([f32::NAN; 6], 30.0, 0.0));
        // A turn about the line of the fingers, which they do not resist, proves nothing of a load without
        // that moment.
        assert!(!proves([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], 30.0, 0.0));
    }
}
