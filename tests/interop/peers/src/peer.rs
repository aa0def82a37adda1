//! The session and node of a peer, with the settings of rmw_zenoh, and its output.

use std::io::Write;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use hiroz::Result;
use hiroz::prelude::*;
use serde_json::Value;
use tracing::field::{Field, Visit};
use tracing_subscriber::layer::{Context, Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

/// Interval of polls.
pub const POLL: Duration = Duration::from_millis(5);

#[derive(clap::Args, Clone)]
pub struct Network {
    /// Endpoint of the router.
    #[arg(long, default_value = "tcp/localhost:7447")]
    pub connect: String,
    #[arg(long, default_value_t = 0)]
    pub domain: usize,
}

impl Network {
    /// Open a session and create a node; both live as long as the result.
    pub fn join(&self, name: &str) -> Result<(ZContext, ZNode)> {
        let context = ZContextBuilder::default()
            .with_domain_id(self.domain)
            .with_connect_endpoints([self.connect.clone()])
            .build()?;
        let node = context.create_node(name).without_parameters().build()?;
        Ok((context, node))
    }
}

pub fn print(value: &Value) {
    println!("{value}");
    std::io::stdout().flush().ok();
}

pub fn reliable(depth: usize) -> QosProfile {
    QosProfile {
        history: keep_last(depth),
        ..Default::default()
    }
}

pub fn latched(depth: usize) -> QosProfile {
    let durability = QosDurability::TransientLocal;
    QosProfile {
        durability,
        history: keep_last(depth),
        ..Default::default()
    }
}

fn keep_last(depth: usize) -> QosHistory {
    QosHistory::KeepLast(NonZeroUsize::new(depth).expect("depth is at least 1"))
}

/// Milliseconds since an instant.
pub fn ms_since(begin: Instant) -> f64 {
    begin.elapsed().as_secs_f64() * 1e3
}

/// Warnings of the library about a second reply to one request.
pub fn count_warnings() -> Arc<AtomicUsize> {
    let extra_replies = Arc::new(AtomicUsize::new(0));
    let counter = ExtraReplies(extra_replies.clone());
    tracing_subscriber::registry().with(counter).init();
    extra_replies
}

struct ExtraReplies(Arc<AtomicUsize>);

impl<S: tracing::Subscriber> Layer<S> for ExtraReplies {
    fn enabled(&self, metadata: &tracing::Metadata<'_>, _: Context<'_, S>) -> bool {
        *metadata.level() <= tracing::Level::WARN
    }

    fn on_event(&self, event: &tracing::Event<'_>, _: Context<'_, S>) {
        let mut text = Message(String::new());
        event.record(&mut text);
        if text.0.contains("extra reply") {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
        eprintln!("{} {}", event.metadata().level(), text.0);
    }
}

struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}
