//! Latched topics, subscribed to after their messages were published.

use std::collections::{BTreeSet, HashMap};
use std::time::{Duration, Instant};

use hiroz::Result;
use hiroz::prelude::*;
use serde_json::json;

use crate::interfaces::{std_msgs::String as Text, tf2_msgs::TFMessage};
use crate::peer::{Network, POLL, latched, ms_since, print};

/// Parent frame of every robot's odometry.
const ROOT_FRAME: &str = "world";

#[derive(clap::Args)]
pub struct Late {
    /// Topic of static transforms.
    #[arg(long, default_value = "/tf_static")]
    tf_static: String,
    /// Depth of its queue; tf2 has 100.
    #[arg(long, default_value_t = 100)]
    depth: usize,
    /// Wait for that many children of the root frame.
    #[arg(long, default_value_t = 0)]
    roots: usize,
    /// Topics of robot descriptions.
    #[arg(long)]
    description: Vec<String>,
    #[arg(long)]
    seconds: f64,
}

impl Late {
    pub fn run(self, network: &Network) -> Result<()> {
        let (_context, node) = network.join("interop_late")?;
        let begin = Instant::now();
        let depth = latched(self.depth);
        let trees = node
            .create_sub::<TFMessage>(&self.tf_static)
            .with_qos(depth)
            .build()?;
        let mut texts = Vec::new();
        for topic in &self.description {
            texts.push((
                topic,
                node.create_sub::<Text>(topic)
                    .with_qos(latched(1))
                    .build()?,
            ));
        }
        let (mut roots, mut messages, mut roots_ms) = (BTreeSet::new(), 0, 0.0);
        let mut described: HashMap<&String, (f64, String)> = HashMap::new();
        let end = begin + Duration::from_secs_f64(self.seconds);
        while Instant::now() < end {
            // As a program does that is slower than the network.
            std::thread::sleep(POLL);
            while trees.is_ready() {
                let message = trees.recv()?;
                messages += 1;
                let children = message.transforms.into_iter();
                let found = children.filter(|one| one.header.frame_id == ROOT_FRAME);
                roots.extend(found.map(|one| one.child_frame_id));
                roots_ms = ms_since(begin);
            }
            for (topic, subscriber) in texts.iter().filter(|(_, one)| one.is_ready()) {
                described.insert(*topic, (ms_since(begin), subscriber.recv()?.data));
            }
            if self.roots > 0 && roots.len() >= self.roots && described.len() == texts.len() {
                break;
            }
        }
        print(&json!({
            "roots": roots, "messages": messages, "roots_ms": roots_ms, "described": described,
        }));
        Ok(())
    }
}
