//! The configuration: the file that the environment names, else the one that the simulation passes on.

use std::path::Path;

use gloaming::scene::Scene;
use gloaming::{Error, Result};

use crate::conduit::Node;
use crate::say;

/// Names the configuration for simulations that know only of other implementations' scripts.
const VARIABLE: &str = "GLOAMING_CONFIG";

/// A file and the overrides that go with it.
struct Script {
    file: String,
    arguments: Vec<String>,
}

/// The scene to show.
pub fn scene(root: &Node) -> Result<Scene> {
    let Script { file, arguments } = match std::env::var(VARIABLE) {
        Ok(file) if !file.is_empty() => Script { file, arguments: vec![] },
        _ => script(root)?,
    };
    if root.get("catalyst/pipelines").is_some() {
        say("catalyst/pipelines is left alone: gloaming writes what its configuration names");
    }
    let text = std::fs::read_to_string(&file).map_err(|e| Error::io(&file, e))?;
    Scene::parse(&of_rank(text)?, &file, &arguments)
}

/// The one script that is a scene file; those of other implementations are left alone.
fn script(root: &Node) -> Result<Script> {
    let mut scripts = vec![];
    for (_, node) in root.get("catalyst/scripts").iter().flat_map(Node::children) {
        let file = match node.text() {
            Some(file) => file,
            None => node.need_text("filename")?,
        };
        let texts = |arguments: Node| {
            arguments.text().into_iter().chain(arguments.children().into_iter().filter_map(|(_, n)| n.text())).collect()
        };
        let arguments = node.get("args").map(texts).unwrap_or_default();
        scripts.push(Script { file, arguments });
    }
    let (mut ours, others): (Vec<_>, Vec<_>) =
        scripts.into_iter().partition(|s| Path::new(&s.file).extension().is_some_and(|e| e == "toml"));
    let named = |scripts: &[Script]| scripts.iter().map(|s| s.file.as_str()).collect::<Vec<_>>().join(", ");
    let remedy = format!("{VARIABLE}=scene.toml, a scene file with an [insitu] table");
    match (ours.pop(), ours.is_empty()) {
        (Some(one), true) => Ok(one),
        (Some(last), false) => {
            let found = format!("{} and {}: gloaming takes one", named(&ours), last.file);
            Err(Error::format("catalyst/scripts", found, remedy))
        }
        (None, _) if others.is_empty() => Err(Error::format("catalyst/scripts", "no configuration", remedy)),
        (None, _) => Err(Error::format("catalyst/scripts", format!("no .toml file, only {}", named(&others)), remedy)),
    }
}

/// Puts the number of this process for `{rank}`.
fn of_rank(text: String) -> Result<String> {
    let number = |name: &str| std::env::var(name).ok().and_then(|v| v.trim().parse::<u64>().ok());
    let known = [
        ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
        ("PMI_RANK", "PMI_SIZE"),
        ("MV2_COMM_WORLD_RANK", "MV2_COMM_WORLD_SIZE"),
        ("SLURM_PROCID", "SLURM_STEP_NUM_TASKS"),
    ];
    let (rank, ranks) = known.iter().find_map(|(r, n)| Some((number(r)?, number(n)?))).unwrap_or((0, 1));
    if ranks > 1 && !text.contains("{rank}") {
        return Err(Error::Unsupported(format!(
            "{ranks} processes, each with its own block, would write the same files\n  try: {{rank}} in insitu.outputs and insitu.ledger"
        )));
    }
    Ok(text.replace("{rank}", &rank.to_string()))
}
