//! The graph: nodes, endpoints, types, hashes.

use std::collections::BTreeSet;
use std::thread::sleep;
use std::time::{Duration, Instant};

use hiroz::Result;
use hiroz::entity::{EndpointEntity, EndpointKind, Entity};
use hiroz::graph::Graph as RosGraph;
use serde_json::{Value, json};

use crate::interfaces::known_hashes;
use crate::peer::{Network, POLL, ms_since, print};

const KINDS: [EndpointKind; 2] = [EndpointKind::Publisher, EndpointKind::Subscription];
const CHECK_EVERY: Duration = Duration::from_millis(20);
const NAME: &str = "interop_graph";

#[derive(clap::Args)]
pub struct Graph {
    /// Number of nodes and endpoints to wait for; 0 = until the graph is quiet.
    #[arg(long, default_value_t = 0)]
    tokens: usize,
    #[arg(long, default_value_t = 20.0)]
    within: f64,
    /// Time without a change after which the graph is quiet [s].
    #[arg(long, default_value_t = 2.0)]
    quiet: f64,
    /// Hash of a type that hiroz 0.2.0 computes otherwise than ROS 2: DDS_TYPE=HASH.
    #[arg(long)]
    hash: Vec<String>,
    /// Print the counts only.
    #[arg(long)]
    brief: bool,
}

impl Graph {
    pub fn run(self, network: &Network) -> Result<()> {
        let begin = Instant::now();
        let (context, _node) = network.join(NAME)?;
        let joined_ms = ms_since(begin);
        let (mut tokens, mut changed) = (0, Instant::now());
        let end = begin + Duration::from_secs_f64(self.within);
        let is_quiet = |since: Instant| since.elapsed().as_secs_f64() > self.quiet;
        while Instant::now() < end {
            let now = count_tokens(context.graph());
            if now != tokens {
                (tokens, changed) = (now, Instant::now());
            }
            if (self.tokens > 0 && tokens >= self.tokens) || (self.tokens == 0 && is_quiet(changed))
            {
                break;
            }
            sleep(CHECK_EVERY);
        }
        let complete_ms = (changed - begin).as_secs_f64() * 1e3;
        let endpoints = list_endpoints(context.graph());
        let mut found = self.compare(&endpoints);
        found["tokens"] = json!(tokens);
        found["joined_ms"] = json!(joined_ms);
        found["complete_ms"] = json!(complete_ms);
        found["nodes"] = json!(list_nodes(context.graph()));
        if !self.brief {
            found["endpoints"] = endpoints.iter().map(describe).collect();
        }
        print(&found);
        Ok(())
    }

    /// Compare the hashes of all endpoints with those of generated code.
    fn compare(&self, endpoints: &[EndpointEntity]) -> Value {
        let mut known = known_hashes();
        for (name, hash) in self.hash.iter().filter_map(|one| one.split_once('=')) {
            known.insert(name.to_string(), [hash.to_string()].into());
        }
        let (mut equal, mut unequal, mut unknown) =
            (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
        for info in endpoints.iter().filter_map(|one| one.type_info.as_ref()) {
            let hash = info.hash.to_rihs_string();
            match known.get(&info.name) {
                None => unknown.insert(info.name.clone()),
                Some(all) if all.contains(&hash) || !hash.starts_with("RIHS01_") => {
                    equal.insert(format!("{} {hash}", info.name))
                }
                Some(all) => unequal.insert(format!("{} {hash}, not {all:?}", info.name)),
            };
        }
        json!({ "equal": equal, "unequal": unequal, "unknown": unknown })
    }
}

#[derive(clap::Args)]
pub struct Watch {
    /// Node, with its namespace: /box_bot0/agent.
    #[arg(long)]
    node: String,
    #[arg(long, default_value_t = 120.0)]
    within: f64,
}

impl Watch {
    pub fn run(self, network: &Network) -> Result<()> {
        let (context, _node) = network.join(NAME)?;
        let (mut was_present, end) = (None, Instant::now() + Duration::from_secs_f64(self.within));
        while Instant::now() < end {
            let is_present = list_nodes(context.graph()).contains(&self.node);
            if was_present != Some(is_present) {
                print(&json!({ "present": is_present }));
                was_present = Some(is_present);
            }
            sleep(POLL);
        }
        Ok(())
    }
}

fn list_nodes(graph: &RosGraph) -> BTreeSet<String> {
    let join =
        |(name, namespace): (String, String)| format!("{}/{name}", namespace.trim_end_matches('/'));
    graph
        .get_node_names()
        .into_iter()
        .map(join)
        .filter(|one| !one.ends_with(NAME))
        .collect()
}

fn count_tokens(graph: &RosGraph) -> usize {
    let nodes = graph
        .get_node_names()
        .into_iter()
        .filter(|(name, _)| name != NAME)
        .count();
    nodes + list_endpoints(graph).len()
}

fn list_endpoints(graph: &RosGraph) -> Vec<EndpointEntity> {
    let mut found = Vec::new();
    for (topic, _) in graph.get_topic_names_and_types() {
        for kind in KINDS {
            found.extend(graph.get_entities_by_topic(kind, &topic));
        }
    }
    for (service, _) in graph.get_service_names_and_types() {
        found.extend(graph.get_entities_by_service(EndpointKind::Service, &service));
    }
    let endpoint = |one: &Entity| match one {
        Entity::Endpoint(endpoint) => Some(endpoint.clone()),
        Entity::Node(_) => None,
    };
    found.iter().filter_map(|one| endpoint(one)).collect()
}

fn describe(one: &EndpointEntity) -> Value {
    let info = one.type_info.as_ref();
    json!({
        "kind": one.kind.to_string(),
        "name": one.topic,
        "type": info.map(|info| info.name.clone()),
        "hash": info.map(|info| info.hash.to_rihs_string()),
        "node": one.node.as_ref().map(|node| format!("{}/{}", node.namespace, node.name)),
        "qos": one.qos.encode(),
    })
}
