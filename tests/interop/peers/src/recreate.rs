//! Create a service client, call, and destroy the client, again and again.

use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use hiroz::Result;
use serde_json::json;
use zenoh::Wait;
use zenoh::query::{ConsolidationMode, Querier, QueryTarget};

use crate::peer::{Network, print};

const REPLY_WITHIN: Duration = Duration::from_secs(12);

#[derive(clap::Args)]
pub struct Recreate {
    /// Data key of the service.
    #[arg(long)]
    key: String,
    #[arg(long, default_value_t = 200)]
    calls: usize,
    /// Let the callback of a reply hold the client, as rmw_zenoh_cpp 0.2.10 does: if the caller
    /// destroys it meanwhile, the callback undeclares the querier, which waits for that callback.
    #[arg(long)]
    held_by_callback: bool,
}

/// What a process of ROS 2 keeps of a service client.
struct Client {
    querier: Mutex<Option<Querier<'static>>>,
    has_reply: Arc<(Mutex<bool>, Condvar)>,
}

impl Drop for Client {
    fn drop(&mut self) {
        if let Some(querier) = self.querier.lock().unwrap().take() {
            let _ = querier.undeclare().wait_callbacks().wait();
        }
    }
}

impl Client {
    fn new(session: &zenoh::Session, key: &str) -> Result<Self> {
        let querier = session
            .declare_querier(key.to_owned())
            .target(QueryTarget::AllComplete)
            .consolidation(ConsolidationMode::None)
            .timeout(REPLY_WITHIN)
            .wait()?;
        Ok(Self {
            querier: Mutex::new(Some(querier)),
            has_reply: Arc::default(),
        })
    }

    fn ask(self: &Arc<Self>, number: usize, is_held: bool) -> Result<()> {
        let (client, has_reply) = (Arc::downgrade(self), self.has_reply.clone());
        let notify = move |_| {
            let _held = is_held.then(|| client.upgrade());
            *has_reply.0.lock().unwrap() = true;
            has_reply.1.notify_all();
        };
        let querier = self.querier.lock().unwrap();
        let get = querier.as_ref().expect("declared").get();
        get.payload(EMPTY_REQUEST)
            .attachment(attachment(number))
            .callback(notify)
            .wait()
    }

    fn waits(&self) -> bool {
        let (replied, condition) = &*self.has_reply;
        let waited = condition
            .wait_timeout_while(replied.lock().unwrap(), REPLY_WITHIN, |replied| !*replied)
            .unwrap();
        !waited.1.timed_out()
    }
}

/// ListParameters without prefixes and of depth 0.
const EMPTY_REQUEST: [u8; 16] = [0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];

fn attachment(number: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    bytes.extend_from_slice(&(number as i64 + 1).to_le_bytes());
    bytes.extend_from_slice(&0i64.to_le_bytes());
    bytes.push(16);
    bytes.extend_from_slice(&[7u8; 16]);
    bytes
}

impl Recreate {
    pub fn run(self, network: &Network) -> Result<()> {
        let mut config = zenoh::Config::default();
        config.insert_json5("mode", "\"client\"")?;
        config.insert_json5("scouting/multicast/enabled", "false")?;
        config.insert_json5("connect/endpoints", &json!([network.connect]).to_string())?;
        let session = zenoh::open(config).wait()?;
        let mut answered = 0;
        while answered < self.calls {
            let client = Arc::new(Client::new(&session, &self.key)?);
            client.ask(answered, self.held_by_callback)?;
            if !client.waits() {
                break;
            }
            answered += 1;
        }
        print(&json!({ "calls": self.calls, "answered": answered }));
        // The session of a client that hangs cannot be closed.
        std::process::exit(0)
    }
}
