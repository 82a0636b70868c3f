//! A small XML document as a tree.

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

/// An element.
#[derive(Debug, Default, Clone)]
pub(crate) struct Element {
    pub name: String,
    attributes: Vec<(String, String)>,
    pub children: Vec<Element>,
    /// Text directly inside, joined.
    pub text: String,
}

impl Element {
    /// Reads a document; one that ends early yields what was there, for a file whose rest is not XML.
    pub fn parse(document: &str) -> Result<Element, String> {
        let mut reader = Reader::from_str(document);
        let mut open = vec![Element::default()];
        let close = |open: &mut Vec<Element>| {
            if let Some(done) = open.pop()
                && let Some(outer) = open.last_mut()
            {
                outer.children.push(done);
            }
        };
        loop {
            match reader.read_event() {
                Ok(Event::Start(start)) => open.push(Element::started(&start)),
                Ok(Event::Empty(start)) => {
                    if let Some(outer) = open.last_mut() {
                        outer.children.push(Element::started(&start));
                    }
                }
                Ok(Event::End(_)) if open.len() > 1 => close(&mut open),
                Ok(Event::Text(text)) => {
                    if let Some(inner) = open.last_mut() {
                        inner.text.push_str(&text.xml10_content());
                    }
                }
                Ok(Event::Eof) => break,
                Ok(_) => {}
                Err(why) if open.len() == 1 => return Err(why.to_string()),
                Err(_) => break,
            }
        }
        while open.len() > 1 {
            close(&mut open);
        }
        open.pop().and_then(|root| root.children.into_iter().next()).ok_or_else(|| "no XML element".into())
    }

    fn started(start: &BytesStart) -> Element {
        let read = |a: quick_xml::events::attributes::Attribute| {
            let value =
                a.normalized_value(XmlVersion::Implicit1_0).map_or_else(|_| a.value.to_string(), |v| v.into_owned());
            (a.key.0.to_owned(), value)
        };
        let attributes = start.attributes().flatten().map(read).collect();
        Element { name: start.name().0.to_owned(), attributes, ..Element::default() }
    }

    /// The value of an attribute, whatever the case of its name.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|(_, v)| v.as_str())
    }

    /// Children of a name.
    pub fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Element> {
        self.children.iter().filter(move |c| c.name == name)
    }

    /// The first child of a name.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|c| c.name == name)
    }

    /// Numbers in an attribute.
    pub fn numbers(&self, name: &str) -> Option<Vec<f64>> {
        numbers(self.attribute(name)?)
    }
}

/// Numbers separated by white space; `None` when some word is not a number.
pub(crate) fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split_whitespace().map(|w| w.parse().ok()).collect()
}
