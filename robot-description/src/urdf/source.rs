//! The text of a URDF: its links and joints, and the lines where they stand.

use std::collections::BTreeMap;
use std::ops::{Range, RangeInclusive};

use roxmltree::{Document, Error, Node};

use crate::file::{MAX_URDF, check_length};
use crate::finding::Report;

/// Deepest nesting of elements: vendors put things of their own into a URDF.
const DEEPEST: usize = 64;

const XACRO: &str = "a robot folder needs plain URDF: generate it with `xacro FILE.xacro > robot.urdf`";

/// Reads the XML.
pub fn parse<'a>(text: &'a str, report: &mut Report) -> Option<Document<'a>> {
    if !check_length(text, MAX_URDF, report) {
        return None;
    }
    match Document::parse(text) {
        Ok(document) => Some(document),
        Err(error) => {
            let line = match error {
                Error::UnclosedRootNode | Error::UnexpectedEndOfStream => text.lines().count().max(1),
                _ => usize::try_from(error.pos().row).unwrap_or(1),
            };
            let advice = match &error {
                Error::UnknownNamespace(prefix, _) if prefix == "xacro" => XACRO.to_owned(),
                Error::UnknownNamespace(prefix, _) => {
                    format!(
                        "remove what starts with {prefix}:, or declare it: <robot xmlns:{prefix}=\"{prefix}\""
                    )
                }
                Error::DtdDetected => "remove <!DOCTYPE …>: a URDF needs none".to_owned(),
                _ => "every <tag> needs a </tag> or />, every attribute value needs quotes".to_owned(),
            };
            report.kinematics(Some(line), format!("malformed XML: {error}"), advice);
            None
        }
    }
}

/// An element with the lines of the text.
#[derive(Clone, Copy)]
pub struct Part<'a> {
    pub node: Node<'a, 'a>,
    starts: &'a [usize],
}

impl<'a> Part<'a> {
    /// `link`, `joint`, …
    pub fn tag(&self) -> &'a str {
        self.node.tag_name().name()
    }

    /// The name, empty when there is none.
    pub fn name(&self) -> &'a str {
        self.attribute("name").unwrap_or_default()
    }

    /// `joint finger_bend`
    pub fn title(&self) -> String {
        format!("{} {}", self.tag(), self.name())
    }

    pub fn attribute(&self, name: &str) -> Option<&'a str> {
        self.node.attribute(name)
    }

    /// The line where it starts, counted from 1.
    pub fn line(&self) -> usize {
        self.line_of(self.node.range().start)
    }

    /// The lines from its start to its end.
    pub fn lines(&self) -> RangeInclusive<usize> {
        self.line()..=self.line_of(self.node.range().end)
    }

    fn line_of(&self, position: usize) -> usize {
        self.starts.partition_point(|&line| line <= position).max(1)
    }

    /// The text up to the end of its start tag.
    pub fn head(&self) -> Range<usize> {
        let end = self.node.first_child().map_or(self.node.range().end, |child| child.range().start);
        0..end
    }

    /// The elements in it, not those in them.
    pub fn parts(&self) -> impl Iterator<Item = Self> + use<'a> {
        let starts = self.starts;
        self.node.children().filter(Node::is_element).map(move |node| Self { node, starts })
    }

    pub fn child(&self, tag: &str) -> Option<Self> {
        self.children(tag).next()
    }

    pub fn children<'t>(&self, tag: &'t str) -> impl Iterator<Item = Self> + use<'a, 't> {
        self.parts().filter(move |part| part.tag() == tag)
    }

    /// This and all that is in it.
    pub fn descendants(&self) -> impl Iterator<Item = Self> + use<'a> {
        let starts = self.starts;
        self.node.descendants().filter(Node::is_element).map(move |node| Self { node, starts })
    }

    /// An attribute that is one finite number.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.attribute(name)?.trim().parse().ok().filter(|value: &f64| value.is_finite())
    }

    /// An attribute that is three finite numbers.
    pub fn vector(&self, name: &str) -> Option<[f64; 3]> {
        let numbers: Option<Vec<f64>> =
            self.attribute(name)?.split_whitespace().map(|word| word.parse().ok()).collect();
        numbers?.try_into().ok().filter(|vector: &[f64; 3]| vector.iter().all(|value| value.is_finite()))
    }

    /// `<tag link="…"/>` of a joint.
    pub fn link(&self, tag: &str) -> Option<&'a str> {
        self.child(tag)?.attribute("link")
    }

    /// Whether a joint turns or slides.
    pub fn moves(&self) -> bool {
        self.attribute("type").is_some_and(|kind| kind != "fixed")
    }
}

/// A `<robot>`.
pub struct Source<'a> {
    pub root: Part<'a>,
    pub links: Vec<Part<'a>>,
    pub joints: Vec<Part<'a>>,
}

impl<'a> Source<'a> {
    /// The robot in `document`.
    pub fn new(document: &'a Document<'a>, starts: &'a [usize], report: &mut Report) -> Option<Self> {
        let root = Part { node: document.root_element(), starts };
        if let Some(line) = too_deep(&root) {
            let message = format!("elements nested more than {DEEPEST} levels deep");
            report.kinematics(Some(line), message, "a URDF is at most 6 levels deep: is a </tag> missing?");
            return None;
        }
        if let Some(part) = root.descendants().find(is_xacro) {
            report.kinematics(Some(part.line()), format!("<xacro:{}> is a macro", part.tag()), XACRO);
            return None;
        }
        if root.tag() != "robot" {
            let advice = "a URDF is one <robot name=\"…\"> with links and joints";
            report.kinematics(Some(root.line()), format!("<{}> is not a robot", root.tag()), advice);
            return None;
        }
        Some(Self { root, links: root.children("link").collect(), joints: root.children("joint").collect() })
    }

    /// The joint or link that is called `name`.
    pub fn joint(&self, name: &str) -> Option<Part<'a>> {
        self.joints.iter().find(|joint| joint.name() == name).copied()
    }
}

/// The line of each by its name.
pub fn lines(parts: &[Part<'_>]) -> BTreeMap<String, usize> {
    parts.iter().map(|part| (part.name().to_owned(), part.line())).collect()
}

/// The line of the first element that is deeper in others than any in a URDF.
fn too_deep(root: &Part<'_>) -> Option<usize> {
    let deep = |part: &Part<'_>| part.node.ancestors().nth(DEEPEST).is_some();
    root.descendants().find(deep).map(|part| part.line())
}

fn is_xacro(part: &Part<'_>) -> bool {
    part.node.tag_name().namespace().is_some_and(|namespace| namespace.contains("xacro"))
}

/// Where the lines of `text` start.
pub fn line_starts(text: &str) -> Vec<usize> {
    std::iter::once(0).chain(text.match_indices('\n').map(|(at, _)| at + 1)).collect()
}
