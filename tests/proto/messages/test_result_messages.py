"""Results, and the error of a refused request."""

from zensim.proto.messages.result_messages import Result, ResultCode, ServiceError


def test_result_defaults_to_ok() -> None:
    assert Result() == Result(ResultCode.OK, "")


def test_service_error_has_code_and_message_in_one_line() -> None:
    error = ServiceError("delete_entity", 2, "NOT_FOUND", "no entity 'r9'; there are 'r1', 'r2'")

    assert str(error) == "NOT_FOUND (2): no entity 'r9'; there are 'r1', 'r2'"
    assert (error.service, error.code, error.code_name) == ("delete_entity", 2, "NOT_FOUND")
    assert error.message == "no entity 'r9'; there are 'r1', 'r2'"
