//! A hand-eye camera before a door: pictures of a door knob as a cheap grey camera sees them.
//!
//! ```text
//!  Scene ─┐
//!  pose  ─┼─► rays ─► radiance ─► vignetting ─► blur ─► exposure ─► noise ─► gamma ─► 8-bit Image
//!  Box   ─┘
//! ```
//!
//! # Frames
//! *Door frame*: origin on the surface of the door at the axis of the knob, x up, y to the right of who
//! stands before the door, z into the door. The knob's tip is at z = −60 mm. A hand straight before the knob
//! has the same orientation: z is its approach, y its closing direction.
//! *Camera frame*: x right, y down, z along the optical axis. A pixel with whole coordinates (u, v) has its
//! centre there, as in OpenCV: the image reaches from −0.5 to width − 0.5.
//!
//! # Rays
//! Every surface is a plane, a cylinder or a cone, and rays meet it in closed form. Where the corners of a
//! pixel see different surfaces, 37 rays tell the share of each, so that edges are right to a few hundredths
//! of a pixel.
//!
//! # Truth
//! A circle in space has an ellipse as its image. Its *centre* is that of the ellipse (not the image of the
//! circle's centre) and its *radius* the geometric mean of the semi-axes, `√(a·b)`.

mod cast;
mod draw;
mod geometry;
mod optics;
mod render;
mod scene;
mod shade;
mod truth;
mod view;

pub use geometry::{Camera, Circle, Ellipse};
pub use optics::{Image, Optics};
pub use scene::{Door, Finish, Frame, Knob, Lamp, Rose, Scene, Texture};
pub use tesaki_description::camera::CameraValues;
pub use truth::{CircleTruth, ImageTruth};
pub use view::{Finger, View};
