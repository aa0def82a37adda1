//! Generated messages and services, and the hashes that this side computes for them.

use std::collections::{HashMap, HashSet};

use serde_json::Value;

/// The newest version of every interface.
#[allow(dead_code, clippy::all)]
pub mod newest {
    include!(concat!(env!("OUT_DIR"), "/newest/generated.rs"));
}
/// simulation_interfaces 1.x.
#[allow(dead_code, clippy::all)]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/v1/generated.rs"));
}

pub use newest::ros::*;

const MANIFESTS: [&str; 2] = [
    include_str!(concat!(env!("OUT_DIR"), "/newest/manifest.json")),
    include_str!(concat!(env!("OUT_DIR"), "/v1/manifest.json")),
];

/// Maps each DDS type to its hashes, one for each version.
pub fn known_hashes() -> HashMap<String, HashSet<String>> {
    let mut known: HashMap<String, HashSet<String>> = HashMap::new();
    let mut add = |name: String, hash: &Value| {
        known.entry(name).or_default().insert(text(hash));
    };
    for manifest in MANIFESTS {
        let manifest: Value = serde_json::from_str(manifest).expect("a manifest is JSON");
        for one in list(&manifest["messages"]) {
            add(dds(one, "msg", ""), &one["type_hash"]);
        }
        for one in list(&manifest["services"]) {
            add(dds(one, "srv", ""), &one["type_hash"]);
        }
        for one in list(&manifest["actions"]) {
            add(dds(one, "action", "_SendGoal"), &one["send_goal_hash"]);
            add(dds(one, "action", "_GetResult"), &one["get_result_hash"]);
            add(
                dds(one, "action", "_FeedbackMessage"),
                &one["feedback_message_hash"],
            );
        }
    }
    known
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map(Vec::as_slice).unwrap_or_default()
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().to_string()
}

fn dds(one: &Value, kind: &str, part: &str) -> String {
    format!(
        "{}::{kind}::dds_::{}{part}_",
        text(&one["package"]),
        text(&one["name"])
    )
}
