//! A hand-eye camera in front of a door: simulates a cheap grey camera's pictures of a door knob.
//!
//! ```text
//!  Scene ─┐
//!  pose  ─┼─► rays ─► radiance ─► vignetting ─► blur ─► exposure ─► noise ─► gamma ─► 8-bit Image
//!  Box   ─┘
//! ```
//!
//! # Frames
//! *Door frame*: origin on the surface of the door at the axis of the knob, x up, y to the right for a person
//! facing the door, z into the door. The knob's tip is at z = −60 mm. A hand straight in front of the knob
//! has the same orientation: z is its approach direction, y its closing direction.
//! *Camera frame*: x right, y down, z along the optical axis. A pixel with whole coordinates (u, v) has its
//! centre there, as in OpenCV: the image extends from −0.5 to width − 0.5.
//!
//! # Rays
//! Every surface is a plane, a cylinder or a cone, and intersections with rays are computed in closed form.
//! If the corners of a pixel see different surfaces, 37 rays determine the area fraction of each, so that
//! edges are accurate to a few hundredths of a pixel.
//!
//! # Truth
//! The image of a circle in space is an ellipse. Its *centre* is that of the ellipse (not the image of the
//! circle's centre), and its *radius* the geometric mean of the semi-axes, `√(a·b)`.

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
