//! Certificates, checked anew in double precision and without the core's own code.

use nalgebra::{Vector3, Vector6};

use super::contacts::Grasp;
use crate::args::Grip;

/// Whether the load has more power against `twist`, about the contacts' centroid, than any forces inside their cones and
/// limits have: then none of them hold it.
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
        rate * f64::from(if rate > 0.0 { contact.limit() } else { asked.least })
    });
    power > most.sum::<f64>()
}
